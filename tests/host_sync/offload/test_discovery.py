from __future__ import annotations

import socket

import pytest
from zeroconf import ServiceInfo, Zeroconf

from host_sync.offload.paired_devices import SERVICE, discover


def test_a_device_is_heard_and_other_servers_are_not() -> None:
    def announced(name: str, properties: dict[str, str]) -> ServiceInfo:
        addresses = [socket.inet_aton("127.0.0.1")]
        return ServiceInfo(
            SERVICE, f"{name}.{SERVICE}", 22, properties=properties, server=f"{name}.local.", addresses=addresses
        )

    try:
        network = Zeroconf(interfaces=["127.0.0.1"])
    except OSError as error:
        pytest.skip(f"no multicast on loopback: {error}")
    with network:
        network.register_service(announced("other", {}))
        network.register_service(announced("bench-7", {"retrograph": "1"}))
        found = discover(30.0, ["127.0.0.1"], wanted="bench-7")
    assert [(one.name, one.host, one.addresses, one.port) for one in found] == [
        ("bench-7", "bench-7.local", ("127.0.0.1",), 22)
    ]
