"""Layers that users add to a model that is there: `LAYERS["elevation"].append(slope)`."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable

from terrafuse.errors import InputError
from terrafuse.models.base import Layer, Model

LAYERS: defaultdict[str, list[Callable[[Model], Layer]]] = defaultdict(list)
"""By the model's name: functions that take the model, so that a layer can build on the model's own ones and on its
settings, and give a layer. They are no part of the model: whoever has them sees them, on any map of that model."""


def layers_of(model: Model) -> dict[str, Layer]:
    """Every layer of a model by name: its own, then what LAYERS adds. Raises InputError for a name given twice."""
    out = dict(model.layers)
    for make in LAYERS.get(model.name, ()):
        layer = make(model)
        if layer.name in out:
            raise InputError(
                f"the model '{model.name}' has a layer '{layer.name}' already; give the added one a new name"
            )
        out[layer.name] = layer
    return out
