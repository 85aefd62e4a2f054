"""The TCP relay: carries all when it is to, and misbehaves as told."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from math import inf, nan

import pytest

from terrafuse.errors import InputError
from terrafuse.testing.relay import Mishaps, Relay, fate_of, main

PATIENCE_S = 10.0
BYTES = bytes(range(256)) * 400


@pytest.fixture
def echo() -> Iterator[str]:
    """HOST:PORT of what sends back all that it gets."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer(connection: socket.socket) -> None:
            with connection:
                try:
                    while data := connection.recv(65_536):
                        connection.sendall(data)
                    connection.shutdown(socket.SHUT_WR)
                except OSError:
                    pass

        def serve() -> None:
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                threading.Thread(target=answer, args=(connection,), daemon=True).start()

        threading.Thread(target=serve, daemon=True).start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)


def connected(address: str) -> socket.socket:
    host, port = address.split(":")
    return socket.create_connection((host, int(port)), PATIENCE_S)


def echoed(address: str, data: bytes) -> bytes:
    """What comes back, up to as many bytes as were sent."""
    with connected(address) as connection:
        sender = threading.Thread(target=connection.sendall, args=(data,), daemon=True)
        sender.start()
        back = b""
        while len(back) < len(data) and (more := connection.recv(65_536)):
            back += more
        return back


def test_all_passes_where_nothing_is_to_go_wrong(echo: str) -> None:
    with Relay(echo) as relay:
        assert [echoed(relay.address, BYTES) for _ in range(3)] == [BYTES] * 3
        assert relay.counts == {
            "connections": 3, "bytes": 6 * len(BYTES), "bytes.forth": 3 * len(BYTES), "bytes.back": 3 * len(BYTES)
        }  # fmt: skip


def test_corruption_flips_single_bits(echo: str) -> None:
    with Relay(echo, Mishaps(corruption=0.2), seed=3) as relay:
        back = echoed(relay.address, BYTES)
        flips = sum((one ^ two).bit_count() for one, two in zip(BYTES, back, strict=True))
        assert 0 < flips == relay.counts["corrupted"]


def test_a_cut_connection_ends_and_the_next_may_live(echo: str) -> None:
    """By the seed: the first connection is cut, the second is not."""
    mishaps = Mishaps(cut=0.5, within_s=0.2)
    seed = next(seed for seed in range(100) if [fate_of(k, mishaps, seed).kind for k in (0, 1)] == ["cut", "none"])
    with Relay(echo, mishaps, seed) as relay:
        with connected(relay.address) as first:
            first.settimeout(PATIENCE_S)
            with pytest.raises(ConnectionError):
                assert first.recv(1), "the relay closed it without a reset"
        assert echoed(relay.address, BYTES) == BYTES
        assert relay.counts["cut"] == 1


def test_a_stalled_connection_stays_and_carries_nothing_until_it_goes_on(echo: str) -> None:
    with Relay(echo, Mishaps(stall=1, within_s=0, stall_s=0.5)) as relay, connected(relay.address) as connection:
        while relay.counts["stalled"] == 0:
            time.sleep(0.01)
        connection.sendall(b"x")
        connection.settimeout(0.1)
        with pytest.raises(TimeoutError):
            connection.recv(1)
        connection.settimeout(PATIENCE_S)
        assert connection.recv(1) == b"x"


def test_delay_and_rate_take_their_time(echo: str) -> None:
    """There and back: 2 · 50 ms; 20 kB at 100 kB/s leave after 200 ms, and come back on the way while they go."""
    with Relay(echo, Mishaps(delay_s=0.05)) as relay:
        started_s = time.monotonic()
        assert echoed(relay.address, b"x") == b"x"
        assert time.monotonic() - started_s >= 0.1
    with Relay(echo, Mishaps(bytes_per_s=100_000)) as relay:
        started_s = time.monotonic()
        assert echoed(relay.address, BYTES[:20_000]) == BYTES[:20_000]
        assert time.monotonic() - started_s >= 0.2


def test_all_can_be_cut_at_once(echo: str) -> None:
    with Relay(echo) as relay:
        held = [connected(relay.address) for _ in range(3)]
        for connection in held:
            connection.sendall(b"x")
            assert connection.recv(1) == b"x"
        relay.cut_all()
        for connection in held:
            with pytest.raises(ConnectionError):
                assert connection.recv(1), "closed without a reset"
            connection.close()


def test_nobody_behind_it_is_counted() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        nobody = f"127.0.0.1:{server.getsockname()[1]}"
    with Relay(nobody) as relay, connected(relay.address) as connection:
        connection.settimeout(PATIENCE_S)
        with pytest.raises(ConnectionError):
            assert connection.recv(1), "closed without a reset"
        assert relay.counts["refused"] == 1


def test_fates_are_as_frequent_as_told_and_the_same_every_time() -> None:
    """Of 2000: 20 % stalled, 10 % cut; five standard deviations of a binomial are 89 and 67."""
    mishaps = Mishaps(stall=0.2, cut=0.1, within_s=4.0)
    fates = [fate_of(k, mishaps, seed=1) for k in range(2000)]
    assert fates == [fate_of(k, mishaps, seed=1) for k in range(2000)]
    kinds = [fate.kind for fate in fates]
    assert abs(kinds.count("stall") - 400) <= 89
    assert abs(kinds.count("cut") - 200) <= 67
    assert 0 <= min(fate.after_s for fate in fates) < max(fate.after_s for fate in fates) <= 4.0


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"cut": 1.1}, "cut = 1.1"),
        ({"stall": nan}, "stall"),
        ({"stall": 0.6, "cut": 0.6}, "at most 1"),
        ({"delay_s": -1.0}, "delay_s"),
        ({"within_s": inf}, "within_s"),
        ({"bytes_per_s": 0.0}, "bytes_per_s"),
    ],
)
def test_impossible_mishaps_are_refused(settings: dict[str, float], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Mishaps(**settings)


@pytest.mark.parametrize("text", ["", "7447", "h:", "h:x", ":7", "h:99999"])
def test_addresses_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="HOST:PORT"):
        Relay(text)


def test_an_address_in_use_is_said_to_be(echo: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--to", echo, "--listen", echo]) == 2
    assert f"can't listen at {echo}" in capsys.readouterr().err


def test_as_a_command(echo: str) -> None:
    command = [sys.executable, "-m", "terrafuse.testing.relay", "--to", echo, "--delay-s", "0.01"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        told = re.match(r"listening at (127\.0\.0\.1:\d+), for " + echo, process.stdout.readline())
        assert told is not None
        assert echoed(told[1], BYTES) == BYTES
        process.terminate()
