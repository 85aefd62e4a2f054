"""The robots of `motion.BODIES`, with mass and wheels."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from terrafuse.simulate.movers import Part, cylinder
from terrafuse.simulate.physics.flying import Flyer
from terrafuse.simulate.physics.machine import Machine
from terrafuse.simulate.physics.wheeled import Caster, Wheel, Wheeled

PAIR = (1.0, -1.0)


def skid_track(wheelbase_m: float, track_m: float) -> float:
    """Of four wheels that all slide as they turn, each as hard as it slips, in the direction of its slip.

    At yaw rate ω each slips by ω·b/2 aside and by v - ω·t/2 ahead, where v is the rim's speed; pushes ahead, at t/2,
    and aside, at b/2, balance when (v - ω·t/2)·t = ω·b/2·b: v = ω·(t² + b²)/(2t).
    """
    return (track_m**2 + wheelbase_m**2) / track_m


MACHINES: Mapping[str, Machine] = MappingProxyType(
    {
        "summit_xl": Wheeled(
            Part(0.72, 0.61, 0.09, 0.5),
            mass_kg=65.0,
            centre_ahead_m=0.0,
            centre_up_m=0.22,
            wheels=tuple(Wheel(x * 0.225, y * 0.235) for x in PAIR for y in PAIR),
            radius_m=0.115,
            wheel_width_m=0.1,
            wheel_kg=2.0,
            firmness_nms=400.0,
            steering_track_m=skid_track(0.45, 0.47),
            sag_m=0.0021,
        ),
        "nomad": Wheeled(
            cylinder(0.534, 0.06, 0.8),
            mass_kg=59.0,
            centre_ahead_m=-0.04,
            centre_up_m=0.2,
            wheels=tuple(Wheel(0.0, y * 0.2) for y in PAIR),
            radius_m=0.075,
            wheel_width_m=0.04,
            wheel_kg=1.0,
            firmness_nms=200.0,
            steering_track_m=0.4,
            sag_m=0.0029,
            casters=(Caster(-0.2, 0.05), Caster(0.2, 0.05, up_m=0.004, give_s=0.15)),
        ),
        "soccer": Wheeled(
            cylinder(0.4, 0.02, 0.6),
            mass_kg=15.0,
            centre_ahead_m=-0.03,
            centre_up_m=0.1,
            wheels=tuple(Wheel(0.0, y * 0.15) for y in PAIR),
            radius_m=0.05,
            wheel_width_m=0.03,
            wheel_kg=0.3,
            firmness_nms=20.0,
            steering_track_m=0.3,
            sag_m=0.0026,
            casters=(Caster(-0.15, 0.03), Caster(0.15, 0.03, up_m=0.002, give_s=0.15)),
        ),
        "drone": Flyer(cylinder(0.8, -0.1, 0.1), mass_kg=3.0, inertia_kgm2=(0.06, 0.06, 0.1)),
    }
)
