"""Prints the golden bytes of frames, posts and summaries, a comment a line.

python -m tests.exchange.make_golden_exchange
"""

from __future__ import annotations

from terrafuse.exchange.framing import frames_of
from terrafuse.exchange.posts import Post, encode_post
from terrafuse.exchange.summary import VERSION, State, Summary, pack

TOPIC = "post/r1/station"
POST = Post(born_ns=5_000_000_000, number=2, kind="route", payload=b"\x01\x02")
HEAD = Summary(VERSION, born_ns=5_000_000_000, said_ns=6_000_000_000, robots={"fine": 2})
STATE = State({"fine": {"r1": 70_000, "r2": 3}}, {b"message": [0, 3, 9, 9]}, [b"another"])


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
    return [
        ("array of 7", message[:1]),
        ("version", message[1:2]),
        ("born_ns", message[2:11]),
        ("said_ns", message[11:20]),
        ("robots: map of 1: of fine, 2", message[20:27]),
        ("held: map of 1: of fine, map of 2", message[27:34]),
        ("r1, 70000", message[34:42]),
        ("r2, 3", message[42:46]),
        ("missing: array of 1: array of 2", message[46:48]),
        ("an id", message[48:57]),
        ("parts 0 to 3, and 9", message[57:62]),
        ("finished: array of 1", message[62:63]),
        ("an id", message[63:]),
    ]


if __name__ == "__main__":
    for parts in (frame_parts(golden_frame()), post_parts(encode_post(POST)), summary_parts(golden_summary())):
        for name, part in parts:
            print(f"    # {name}")
            print(f'    "{part.hex()}"')
        print()
