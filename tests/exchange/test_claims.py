"""A claim says up to which revision a robot's contribution is whole: nobody may follow it without its tiles."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from terrafuse.exchange.channel import Channel
from terrafuse.exchange.codec import encode
from terrafuse.exchange.holding import Holding
from terrafuse.exchange.piece import Piece
from terrafuse.store.memory import MemoryStore
from terrafuse.testing.deltas import deltas_of, random_scans
from tests.exchange.fleet import LATTICE, MODEL


def test_who_could_not_take_a_claim_s_own_tiles_does_not_follow_it() -> None:
    """The second delta's tiles follow revision 1, which is not here."""
    _, second = deltas_of("r0", random_scans(1, 2), LATTICE, MODEL)
    store = MemoryStore(LATTICE, MODEL)
    holding = Holding(Channel("fine", store), Counter())
    piece = Piece(2, [1], (0, 2, []), False, encode(replace(second, since=2)))
    assert not holding.apply("station", "r0", piece, 0)
    assert store.level("r0") == 0
    assert not store.keys()
