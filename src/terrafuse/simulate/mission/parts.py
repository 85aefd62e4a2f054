"""What a scenario's parts stand for: the sensors and behaviours of its robots, and whether its model is one.

Errors name the scenario's line.
"""

from __future__ import annotations

from typing import Any

from terrafuse.errors import InputError
from terrafuse.models import MODELS, make_model
from terrafuse.sense import Sensor, load_sensor
from terrafuse.sense.describe import described
from terrafuse.simulate.mission.behaviours import BEHAVIOURS
from terrafuse.simulate.mission.behaviours.base import Makes
from terrafuse.simulate.scenario import Loaded
from terrafuse.simulate.scenario.model import Part
from terrafuse.simulate.scenario.read import checked


def check_parts(loaded: Loaded) -> None:
    """Raise InputError for what is wrong whatever the world: the model, a behaviour, a sensor."""
    _check_model(loaded)
    for index, part in enumerate(loaded.scenario.robots):
        behaviour_of(loaded, index)
        for k in range(len(part.sensors)):
            sensor_of(loaded, index, k)


def _check_model(loaded: Loaded) -> None:
    part = loaded.scenario.map
    try:
        model = make_model(part.model, part.settings)
    except InputError as error:
        blamed = ("settings", next((key for key in part.settings if key in str(error)), ""))
        raise loaded.error(("map", *(blamed if part.model in MODELS else ("model",))), str(error)) from error
    if part.prior_building_height_m is not None and not hasattr(model, "prior"):
        takers = " or ".join(name for name, make in MODELS.items() if hasattr(make, "prior"))
        raise loaded.error(
            ("map", "prior_building_height_m"),
            f"the cell model '{part.model}' can't be told what is known beforehand; leave it out, or take {takers}",
        )


def behaviour_of(loaded: Loaded, index: int) -> tuple[Any, Makes]:
    """The settings of what this kind of robots does, and what makes one robot's of them."""
    place = ("robots", index, "behaviour")
    kind = loaded.scenario.robots[index].behaviour.kind
    if kind not in BEHAVIOURS:
        raise loaded.error((*place, "kind"), f"behaviour '{kind}'; there are {', '.join(BEHAVIOURS)}")
    settings, makes = BEHAVIOURS[kind]
    made: Part = checked(loaded.document, settings, place, leaving_out=["kind"])
    return made, makes


def sensor_of(loaded: Loaded, index: int, k: int) -> Sensor:
    """A sensor of this kind of robots."""
    part = loaded.scenario.robots[index].sensors[k]
    place = ("robots", index, "sensors", k, "description")
    if isinstance(part.description, str):
        beside = loaded.beside(part.description)
        with loaded.at(*place):
            sensor = load_sensor(beside if beside.is_file() else part.description)
    else:
        sensor = described(loaded.document.within(place))
    if sensor.beams is None:
        raise loaded.error(place, f"the sensor {sensor.name} has no beams; give it a 'ring', or 'beams'")
    if part.kind == "sonar" and not sensor.cone_half_angle_rad:
        raise loaded.error(
            place, f"the sensor {sensor.name} has rays; a sonar needs cone_half_angle_deg and range_error_m"
        )
    return sensor
