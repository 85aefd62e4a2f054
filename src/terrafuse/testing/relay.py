"""A TCP relay that does to connections of real processes what MisbehavingLink does to frames.

    python -m terrafuse.testing.relay --to 127.0.0.1:7447 --listen 127.0.0.1:7500 --stall 0.2 --cut 0.1 --seed 7

    with Relay("127.0.0.1:7447", Mishaps(cut=0.3)) as relay:
        ... connect to relay.address ...

It knows nothing of what it carries. What befalls the n-th connection is drawn from the seed and n; when, in bytes and
seconds, depends on who uses it.
"""

from __future__ import annotations

import argparse
import asyncio
import socket
import struct
import sys
import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import inf, isfinite

import numpy as np

from terrafuse.cli.output import fail, say
from terrafuse.errors import InputError, TerrafuseError
from terrafuse.exchange.links.faults import flipped

CHUNK = 4096
WAITING_CHUNKS = 64
"""What may be under way one way of a connection; its sender waits then."""
LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Mishaps:
    """What goes wrong. The default is nothing. Chances are 0 to 1."""

    stall: float = 0.0
    """Chance of a connection that one day nothing passes any more, and neither side is told."""
    cut: float = 0.0
    """Chance of a connection that it is reset. One is stalled or cut, not both."""
    within_s: float = 5.0
    """How old a connection is then: evenly spread up to this."""
    stall_s: float = inf
    """Until a stalled connection goes on."""
    corruption: float = 0.0
    """Chance of one flipped bit in a chunk of up to 4096 bytes."""
    delay_s: float = 0.0
    jitter_s: float = 0.0
    """Up to this much is added to the delay, evenly spread; nothing overtakes."""
    bytes_per_s: float = inf
    """Of each connection, each way."""

    def __post_init__(self) -> None:
        for name in ("stall", "cut", "corruption"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} = {getattr(self, name)}: a chance is from 0 to 1")
        if self.stall + self.cut > 1:
            raise InputError(f"stall {self.stall} + cut {self.cut}: a connection has one of both; at most 1 together")
        for name in ("delay_s", "jitter_s", "within_s"):
            if not 0 <= getattr(self, name) < inf:
                raise InputError(f"{name} = {getattr(self, name)}: give a number from 0 on")
        for name in ("bytes_per_s", "stall_s"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} = {getattr(self, name)}: give a positive number, inf for no limit")


HARMLESS = Mishaps()


@dataclass(frozen=True)
class Fate:
    """Of one connection."""

    kind: str
    """stall, cut or none."""
    after_s: float


def fate_of(connection: int, mishaps: Mishaps, seed: int) -> Fate:
    which, when = np.random.default_rng((seed, connection)).random(2).tolist()
    after_s = when * mishaps.within_s
    if which < mishaps.stall:
        return Fate("stall", after_s)
    return Fate("cut" if which < mishaps.stall + mishaps.cut else "none", after_s)


class Relay:
    """Runs in a thread of its own, from entering to leaving it as a context. Raises InputError for addresses.

    `counts`: connections, refused (nobody listened behind the relay), stalled, cut, corrupted (chunks), bytes; of
    these bytes.forth, of who connected, and bytes.back.
    """

    def __init__(self, to: str, mishaps: Mishaps = HARMLESS, seed: int = 0, listen: str = f"{LOOPBACK}:0") -> None:
        self.mishaps, self.seed = mishaps, seed
        self.counts: Counter[str] = Counter()
        self._to, self._listen = _host_port(to), _host_port(listen)
        self._open: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="relay", daemon=True)

    @property
    def address(self) -> str:
        """Where it listens, HOST:PORT."""
        return f"{self._listen[0]}:{self._listen[1]}"

    def __enter__(self) -> Relay:
        self._thread.start()
        self._do(self._start())
        return self

    def __exit__(self, *_: object) -> None:
        self._do(self._stop())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def cut_all(self) -> None:
        """Reset every connection now."""
        self._loop.call_soon_threadsafe(self._reset_all)

    def _do(self, work: object) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result()  # type: ignore[arg-type]

    async def _start(self) -> None:
        try:
            self._server = await asyncio.start_server(self._connect, *self._listen)
        except OSError as error:
            raise InputError(f"can't listen at {self.address}: {error.strerror}; choose another port") from error
        self._listen = self._server.sockets[0].getsockname()[:2]

    async def _stop(self) -> None:
        self._server.close()
        self._reset_all()
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _reset_all(self) -> None:
        for writer in self._open.copy():
            _reset(writer)

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        number = self.counts["connections"]
        self.counts["connections"] += 1
        try:
            further, beyond = await asyncio.open_connection(*self._to)
        except OSError:
            self.counts["refused"] += 1
            _reset(writer)
            return
        both = {writer, beyond}
        self._open |= both
        try:
            await self._carry(number, (reader, beyond), (further, writer))
        except (OSError, asyncio.CancelledError):
            pass  # how connections end
        finally:
            self._open -= both
            for end in both:
                end.close()

    async def _carry(self, number: int, *ways: tuple[asyncio.StreamReader, asyncio.StreamWriter]) -> None:
        """Until either side leaves, or what is to befall the connection has."""
        fate, passing = fate_of(number, self.mishaps, self.seed), asyncio.Event()
        passing.set()
        work = [self._befall(fate, passing)] if fate.kind != "none" else []
        for side, (reader, writer) in enumerate(ways):
            rng, queue = np.random.default_rng((self.seed, number, side)), asyncio.Queue[_Due](WAITING_CHUNKS)
            counted = ("bytes", ("bytes.forth", "bytes.back")[side])
            work += [self._read(reader, queue, rng, passing, counted), self._write(queue, writer)]
        tasks = [asyncio.ensure_future(each) for each in work]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if fate.kind == "cut" and tasks[0].done():
                for _, writer in ways:
                    _reset(writer)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _befall(self, fate: Fate, passing: asyncio.Event) -> None:
        """Ends the connection by ending, if it is to be cut."""
        await asyncio.sleep(fate.after_s)
        self.counts["cut" if fate.kind == "cut" else "stalled"] += 1
        if fate.kind == "stall":
            passing.clear()
            await _sleep(self.mishaps.stall_s)
            passing.set()
            await _sleep(inf)

    async def _read(
        self,
        reader: asyncio.StreamReader,
        queue: asyncio.Queue[_Due],
        rng: np.random.Generator,
        passing: asyncio.Event,
        counted: Sequence[str],
    ) -> None:
        loop, free_s = asyncio.get_running_loop(), 0.0
        while chunk := await reader.read(CHUNK):
            await passing.wait()
            damaged, bit, jitter = rng.random(3).tolist()
            if damaged < self.mishaps.corruption:
                self.counts["corrupted"] += 1
                chunk = flipped(chunk, int(bit * 8 * len(chunk)))
            for name in counted:
                self.counts[name] += len(chunk)
            free_s = max(free_s, loop.time()) + len(chunk) / self.mishaps.bytes_per_s
            await _sleep(free_s - loop.time())
            await queue.put((free_s + self.mishaps.delay_s + jitter * self.mishaps.jitter_s, chunk))
        await queue.put((0.0, b""))
        await _sleep(inf)

    async def _write(self, queue: asyncio.Queue[_Due], writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        while True:
            due_s, chunk = await queue.get()
            if not chunk:
                return
            await _sleep(due_s - loop.time())
            writer.write(chunk)
            await writer.drain()


_Due = tuple[float, bytes]
"""When a chunk is to leave, by the loop's clock, and the chunk; an empty one is the end."""


def _reset(writer: asyncio.StreamWriter) -> None:
    """End a connection as a broken one does, not as one that is closed in order."""
    if (end := writer.get_extra_info("socket")) is not None and end.fileno() >= 0:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


async def _sleep(for_s: float) -> None:
    if isfinite(for_s):
        if for_s > 0:
            await asyncio.sleep(for_s)
    else:
        await asyncio.Event().wait()


def _host_port(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not (colon and host and port.isdecimal() and int(port) <= 65_535):
        raise InputError(f"address '{text}': give HOST:PORT, like {LOOPBACK}:7447")
    return host.strip("[]"), int(port)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m terrafuse.testing.relay", description="A TCP relay that misbehaves.")
    parser.add_argument("--to", required=True, metavar="HOST:PORT", help="where to pass connections on")
    parser.add_argument("--listen", default=f"{LOOPBACK}:0", metavar="HOST:PORT", help="default: a free port here")
    parser.add_argument("--seed", type=int, default=0)
    for field in fields(Mishaps):
        parser.add_argument(f"--{field.name.replace('_', '-')}", type=float, default=field.default, metavar="X")
    given = vars(parser.parse_args(arguments))
    to, listen, seed = (given.pop(name) for name in ("to", "listen", "seed"))
    try:
        with Relay(to, Mishaps(**given), seed, listen) as relay:
            say(f"listening at {relay.address}, for {to}")
            sys.stdout.flush()
            threading.Event().wait()
    except TerrafuseError as error:
        return fail(error, as_json=False)
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
