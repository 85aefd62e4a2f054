"""Prints the golden bytes of frames, posts, summaries, pieces and digests, a comment a line.

python -m tests.exchange.make_golden_exchange
"""

from __future__ import annotations

from terrafuse.exchange.contents import Digests, encode_digests
from terrafuse.exchange.framing import frames_of
from terrafuse.exchange.known import Claim
from terrafuse.exchange.piece import Piece, encode_piece, pack_claim
from terrafuse.exchange.posts import Post, encode_post
from terrafuse.exchange.summary import VERSION, State, Summary, pack
from terrafuse.types import TileKey

TOPIC = "post/r1/station"
POST = Post(born_ns=5_000_000_000, number=2, kind="route", payload=b"\x01\x02")
HEAD = Summary(VERSION, born_ns=5_000_000_000, said_ns=6_000_000_000, robots={"fine": 2}, area=(0.0, 1.5, 40.0, 80.0))
STATE = State(
    held={"fine": {"r1": 70_000, "r2": 3}},
    missing={b"message": [0, 3, 9, 9]},
    finished=[b"another"],
    ahead={"fine": {"r2": [(-1, 2, 5)]}},
    roots={"fine": {"r1": 258}},
)
PIECE = Piece(until=7, sinces=[3, 5], claim=pack_claim(Claim(3, 7, ((TileKey(-1, 2), 6),))), again=False, delta=b"TFD")
DIGESTS = Digests("r1", 7, [(-1, 2, 258)])


def golden_frame() -> bytes:
    """The second of the three frames of a post."""
    return frames_of(TOPIC, encode_post(POST), 26)[1].payload


def golden_summary() -> bytes:
    (message,) = pack(HEAD, STATE, 1000)
    return message


def frame_parts(payload: bytes) -> list[tuple[str, bytes]]:
    """The frame cut as exchange/framing.py describes it."""
    return [
        ("CRC-32 of the topic and of what follows", payload[:4]),
        ("version", payload[4:5]),
        ("id of the message", payload[5:12]),
        ("number of the part", payload[12:14]),
        ("parts", payload[14:16]),
        ("the part", payload[16:]),
    ]


def post_parts(message: bytes) -> list[tuple[str, bytes]]:
    """The post cut as exchange/posts.py describes it."""
    return [
        ("array of 4", message[:1]),
        ("born_ns", message[1:10]),
        ("number", message[10:11]),
        ("kind", message[11:17]),
        ("payload", message[17:]),
    ]


def summary_parts(message: bytes) -> list[tuple[str, bytes]]:
    """The summary cut as exchange/summary.py describes it."""
    return _cut(message, [
        ("array of 10", 1), ("version", 1), ("born_ns", 9), ("said_ns", 9),
        ("robots: map of 1: of fine, 2", 7), ("held: map of 1: of fine, map of 2", 7), ("r1, 70000", 8), ("r2, 3", 4),
        ("missing: array of 1: array of 2", 2), ("an id", 9), ("parts 0 to 3, and 9", 5),
        ("finished: array of 1", 1), ("an id", 9),
        ("ahead: map of 1: of fine, map of 1", 7), ("r2, array of 3: tile (-1, 2), 2 beyond", 7),
        ("roots: map of 1: of fine, map of 1", 7), ("r1, 258", 6),
        ("area: array of 4: west, south, east, north", 37),
    ])  # fmt: skip


def piece_parts(message: bytes) -> list[tuple[str, bytes]]:
    """The piece cut as exchange/piece.py describes it."""
    return _cut(message, [
        ("array of 5", 1), ("until", 1), ("sinces: array of 2", 3), ("claim: array of 3: since, until", 3),
        ("array of 3: tile (-1, 2), 1 back", 4), ("again", 1), ("the delta", 5),
    ])  # fmt: skip


def digests_parts(message: bytes) -> list[tuple[str, bytes]]:
    """The digests cut as exchange/contents.py describes them."""
    return _cut(message, [
        ("array of 3", 1), ("robot", 3), ("base", 1), ("array of 1: array of 3: tile (-1, 2), 258", 7),
    ])  # fmt: skip


def _cut(message: bytes, parts: list[tuple[str, int]]) -> list[tuple[str, bytes]]:
    out, at = [], 0
    for name, size in parts:
        out.append((name, message[at : at + size]))
        at += size
    return out


if __name__ == "__main__":
    for parts in (
        frame_parts(golden_frame()),
        post_parts(encode_post(POST)),
        summary_parts(golden_summary()),
        piece_parts(encode_piece(PIECE)),
        digests_parts(encode_digests(DIGESTS)),
    ):
        for name, part in parts:
            print(f"    # {name}")
            print(f'    "{part.hex()}"')
        print()
