"""One connection to a device over SSH with an SFTP session on it: pinned key, fast ciphers, bounded silence."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import asyncssh

from host_sync.offload.paired_devices import PairedDevice

CIPHERS: Final = ("aes128-gcm@openssh.com", "aes256-gcm@openssh.com", "chacha20-poly1305@openssh.com")
PACKET_BYTES: Final = 128 << 10

_SIGNATURES: Final = {"ssh-rsa": ["rsa-sha2-512", "rsa-sha2-256"]}
"""How a host proves a key whose kind is not also the name of its signature."""


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """One connection and the SFTP session on it; after a cut another takes its place."""

    connection: asyncssh.SSHClientConnection
    client: asyncssh.SFTPClient


@dataclass(frozen=True, slots=True)
class Patience:
    """How long silence is borne, s.

    keepalive_s : between questions whether the other side is there
    unanswered : questions without an answer after which the connection counts as lost
    give_up_s : since something came last, after which reconnecting ends
    retry_s : between two tries
    """

    keepalive_s: float = 1.0
    unanswered: int = 3
    give_up_s: float = 8.0
    retry_s: float = 0.25


async def open_session(device: PairedDevice, private_key: Path, patience: Patience, within_s: float) -> Session:
    """A fresh session with a device, by its pinned key alone.

    Raises
    ------
    asyncssh.Error, OSError
        It cannot be reached within that time, shows another key, or does not accept ours.
    """
    key = asyncssh.import_public_key(device.host_key)
    kind = device.host_key.partition(" ")[0]
    async with asyncio.timeout(within_s):
        connection = await asyncssh.connect(
            device.host,
            device.port,
            username=device.user,
            client_keys=[str(private_key)],
            known_hosts=([key], [], []),
            server_host_key_algs=_SIGNATURES.get(kind, [kind]),
            encryption_algs=CIPHERS,
            compression_algs=None,
            preferred_auth="publickey",
            agent_path=None,
            config=None,
            keepalive_interval=patience.keepalive_s,
            keepalive_count_max=patience.unanswered,
        )
        try:
            # The session that SFTP opens takes its packet size from nowhere else; large ones cost a seventh less.
            session = partial(connection.create_session, max_pktsize=PACKET_BYTES)
            connection.create_session = session  # type: ignore[method-assign]
            return Session(connection, await connection.start_sftp_client())
        except BaseException:
            connection.abort()
            raise


def explain_refusal(device: PairedDevice, cause: BaseException) -> str:
    """What a refusal means and what to do, in a sentence."""
    where = f"{device.device_id} ({device.host}:{device.port})"
    if isinstance(cause, asyncssh.HostKeyNotVerifiable):
        return (
            f"{where}: shows another key than the one it was paired with, so it was set up anew or something else "
            "answers in its place: if you set it up anew, pair it again with --replace; otherwise do not"
        )
    return f"{where}: does not accept this workstation's key: pair it again"
