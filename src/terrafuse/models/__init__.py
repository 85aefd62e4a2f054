"""The cell models, by name. A model is one object; add your own with `MODELS["mine"] = Mine`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from typing import Any

from terrafuse.errors import InputError
from terrafuse.models.base import Layer, Model, Observer, Patch, Reading, fold, patch_of
from terrafuse.models.elevation import Elevation
from terrafuse.models.grey import Grey
from terrafuse.models.layers import LAYERS, check_layers, layers_of
from terrafuse.models.occupancy import Occupancy
from terrafuse.models.terrain import Terrain
from terrafuse.plugins import HINT
from terrafuse.settings import misfit

MODELS: dict[str, Callable[..., Model]] = {
    "elevation": Elevation,
    "grey": Grey,
    "occupancy": Occupancy,
    "terrain": Terrain,
}


def make_model(name: str, settings: Mapping[str, Any] | None = None) -> Model:
    """The model of this name with these settings; raises InputError for a name or a setting that there is none of."""
    if name not in MODELS:
        raise InputError(f"no cell model '{name}'; there are: {', '.join(sorted(MODELS))}; {HINT}")
    given, make = dict(settings or {}), MODELS[name]
    known = signature(make).parameters
    if not any(parameter.kind is Parameter.VAR_KEYWORD for parameter in known.values()):
        for key in given.keys() - known.keys():
            raise InputError(f"cell model '{name}' has no setting '{key}'; there are: {', '.join(known)}")
    if (wrong := misfit(make, given)) is not None:
        raise InputError(f"cell model '{name}': {wrong}")
    try:
        return make(**given)
    except TypeError as error:
        raise InputError(f"cell model '{name}': a setting of {given} has the wrong type: {error}") from error


__all__ = [
    "LAYERS", "MODELS", "Layer", "Model", "Observer", "Patch", "Reading", "check_layers", "fold",
    "layers_of", "make_model", "patch_of",
]  # fmt: skip
