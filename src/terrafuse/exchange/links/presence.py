"""Who is there, and that no two nodes go by one name.

Each life of a node puts up a sign, `terrafuse-nodes/ROLE/NODE/LIFE`, which Zenoh takes down when its connection ends;
and it answers to its name, `terrafuse-names/NODE`, with its LIFE. ROLE is `hub` for who listens, `end` for who only
connects. An end looks for hubs and for its own name alone, until somebody asks it for all nodes: or a thousand robots
would have a million signs to read whenever their station comes back.

Signs alone would not do: that of a robot which was killed behind a dead connection stands for `hung_s`, and the robot,
restarted, is not to be refused for its own ghost. So who sees a sign of its own name asks, and only an answer counts.
Of two lives the older one stays.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from typing import Any

from terrafuse.exchange.links.topics import key_of, topic_of

SIGNS = "terrafuse-nodes"
NAMES = "terrafuse-names"
ANSWER_S = 2.0


def new_life() -> str:
    """Sorts by when it began, as far as clocks agree; no two are equal."""
    return f"{time.time_ns():016x}-{secrets.token_hex(4)}"


class Presence:
    """One node's, for as long as it lives: over all its sessions. `on_namesake()` is called, by whatever thread, when
    there is a sign of another life of its name. What takes a session calls into Zenoh, which may take its time."""

    def __init__(self, node: str, hub: bool, on_namesake: Callable[[], None]) -> None:
        self.node, self.life = node, new_life()
        self._role, self._sees_all = ("hub" if hub else "end"), hub
        self._watched: set[str] = set()
        self._on_namesake = on_namesake
        self._signs: set[tuple[str, str]] = set()

    def nodes(self) -> list[str]:
        """The other nodes, sorted. At an end, the first answers may have those who listen only."""
        self._sees_all = True
        return sorted({node for node, _ in self._signs.copy() if node != self.node})

    @property
    def accompanied(self) -> bool:
        """Whether there is a sign of anybody else."""
        return any(node != self.node for node, _ in self._signs.copy())

    def join(self, session: Any) -> None:
        """Put up the sign on a new session, and watch for others'."""
        import zenoh

        self._watched, self._signs = set(), set()
        session.declare_queryable(f"{NAMES}/{key_of(self.node)}", zenoh.handlers.Callback(self._answer, indirect=False))
        self._sign = session.liveliness().declare_token(f"{SIGNS}/{self._role}/{key_of(self.node)}/{self.life}")
        self.look(session)

    def look(self, session: Any) -> None:
        """Watch for what is to be seen by now."""
        for signs in ("hub/*/*", "end/*/*" if self._sees_all else f"end/{key_of(self.node)}/*"):
            if session is not None and signs not in self._watched:
                self._watched.add(signs)
                self._watch(session, signs)

    def namesake(self, session: Any) -> str | None:
        """The older life that answers to this node's name, if there is one."""
        import zenoh

        replies = session.get(
            f"{NAMES}/{key_of(self.node)}",
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            allowed_destination=zenoh.Locality.REMOTE,
            timeout=ANSWER_S,
        )
        lives = [reply.ok.payload.to_string() for reply in replies if reply.ok is not None]
        return min((life for life in lives if life < self.life), default=None)

    def lost(self) -> None:
        """The session is gone; what is known of others is too."""
        self._signs = set()

    def _watch(self, session: Any, signs: str) -> None:
        import zenoh

        see = zenoh.handlers.Callback(self._see, indirect=False)
        session.liveliness().declare_subscriber(f"{SIGNS}/{signs}", see, history=True)

    def _answer(self, query: Any) -> None:
        query.reply(f"{NAMES}/{key_of(self.node)}", self.life)

    def _see(self, sample: Any) -> None:
        _, _, node, life = topic_of(str(sample.key_expr)).split("/")
        if str(sample.kind) != "SampleKind.PUT":
            self._signs.discard((node, life))
            return
        self._signs.add((node, life))
        if node == self.node and life != self.life:
            self._on_namesake()
