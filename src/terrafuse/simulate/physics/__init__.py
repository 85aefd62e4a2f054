"""Robots with real physics, by MuJoCo: contact, friction, slope and weight, where `simulate.motion` has none.

physics = Physics(world, {"r": "summit_xl"}, {"r": placed(ground, BODIES["summit_xl"], [(0, 0)], [0.0])})
states = physics.step({"r": command}, dt_s=0.1, time_s=0.0)   # the same State as motion.step gives
"""

from __future__ import annotations

from terrafuse.simulate.physics.engine import Physics, PhysicsSettings
from terrafuse.simulate.physics.machines import MACHINES

__all__ = ["MACHINES", "Physics", "PhysicsSettings"]
