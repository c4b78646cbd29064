"""The bill of materials of a release in CycloneDX 1.6: what a handheld gets, from requirements-device.lock.

usage: python .ci/sbom.py FOLDER     writes FOLDER/sbom.cdx.json about the release in FOLDER

The same release gives the same bytes: no time, and a serial number from the content.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
import uuid
from importlib import metadata
from pathlib import Path
from typing import Any

PIN = re.compile(r"^([a-z0-9._-]+)==([^ ;\\]+)")
CONDITION = re.compile(r" ; ([^\\]+?) *\\?$")
HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})")
VENDORED = (("three", "0.187.0", "MIT"),)
"""What the wheel brings unchanged; NOTICE says where."""


def pinned(lock: str) -> list[dict[str, Any]]:
    """The packages of a lock; any of the listed files of a package may be installed."""
    found: list[dict[str, Any]] = []
    for line in lock.splitlines():
        if pin := PIN.match(line):
            name, version = pin.groups()
            component = library(f"pkg:pypi/{name}@{version}", name, version, licence_of(name, version))
            if condition := CONDITION.search(line):
                component["properties"].append({"name": "retrograph:condition", "value": condition[1]})
            found.append(component)
        for digest in HASH.findall(line):
            found[-1]["properties"].append({"name": "retrograph:file-sha256", "value": digest})
    return found


def library(purl: str, name: str, version: str, licence: str | None) -> dict[str, Any]:
    """One component."""
    known = {"licenses": [{"license": {"name": licence}}]} if licence else {}
    return {
        "type": "library",
        "bom-ref": purl,
        "name": name,
        "version": version,
        "purl": purl,
        **known,
        "properties": [],
    }


def licence_of(name: str, version: str) -> str | None:
    """What the package says of its licence, when that very version is installed here."""
    try:
        facts = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return None
    said = facts.get("License-Expression") or facts.get("License") or ""
    if not said or "\n" in said:
        kinds = [kind.rpartition(" :: ")[2] for kind in facts.get_all("Classifier") or [] if kind.startswith("License")]
        said = ", ".join(kinds)
    return said if said and facts.get("Version") == version else None


def bill(folder: Path) -> dict[str, Any]:
    """The bill of the release in a folder."""
    (wheel,) = folder.glob("retrograph-*.whl")
    version = wheel.name.split("-")[1]
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    own = library(f"pkg:pypi/retrograph@{version}", "retrograph", version, "Apache-2.0")
    own |= {"type": "application", "hashes": [{"alg": "SHA-256", "content": digest}]}
    lock = (folder / "requirements-device.lock").read_text(encoding="utf-8")
    parts = pinned(lock) + [library(f"pkg:npm/{name}@{v}", name, v, licence) for name, v, licence in VENDORED]
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": uuid.uuid5(uuid.NAMESPACE_OID, digest + lock).urn,
        "version": 1,
        "metadata": {"component": own},
        "components": parts,
        "dependencies": [{"ref": own["bom-ref"], "dependsOn": [part["bom-ref"] for part in parts]}],
    }


if __name__ == "__main__":
    target = Path(sys.argv[1])
    (target / "sbom.cdx.json").write_text(json.dumps(bill(target), indent=1) + "\n", encoding="utf-8")
