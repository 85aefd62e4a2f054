"""Layers that users add to a model that is there: `LAYERS["elevation"].append(slope)`."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from terrafuse.errors import InputError
from terrafuse.models.base import Layer, Model, Reading
from terrafuse.plugins import HINT, file_of, said_of
from terrafuse.types import Array, Floats

LAYERS: defaultdict[str, list[Callable[[Model], Layer]]] = defaultdict(list)
"""By the model's name: functions that take the model, so that a layer can build on the model's own ones and on its
settings, and give a layer. They are no part of the model: whoever has them sees them, on any map of that model."""

MOST_HALO = 64


def layers_of(model: Model) -> dict[str, Layer]:
    """Every layer of a model by name: its own, then what LAYERS adds. Raises InputError for a name given twice, and for
    what is no layer; an added layer that fails raises InputError when it is computed."""
    check_layers()
    out = dict(model.layers)
    for make in LAYERS.get(model.name, ()):
        layer = _made(make, model)
        if layer.name in out:
            raise InputError(
                f"the model '{model.name}' has a layer '{layer.name}' already; give the added one a new name"
            )
        out[layer.name] = layer
    return out


def check_layers() -> None:
    """Raise InputError for layers of a model that there is none of, and for what are no functions."""
    from terrafuse.models import MODELS

    for name, makers in LAYERS.items():
        functions = isinstance(makers, list) and all(map(callable, makers))
        if not functions:
            raise InputError(f"LAYERS['{name}']: holds {makers!r:.60}; append a function, model → Layer")
        if makers and name not in MODELS:
            file, known = file_of(makers[0]), ", ".join(sorted(MODELS))
            raise InputError(f"LAYERS['{name}'] of {file}: there is no such cell model; there are: {known}; {HINT}")


def _made(make: Callable[[Model], Layer], model: Model) -> Layer:
    """The layer that a function adds, whose values are looked at whenever it is computed."""
    file = file_of(make)
    with said_of(f"a layer of {file} for '{model.name}'"):
        layer = make(model)
    if not isinstance(layer, Layer) or not (isinstance(layer.name, str) and callable(layer.compute)):
        raise InputError(f"a layer of {file} for '{model.name}': {layer!r:.60} is no Layer(name, unit, …, compute)")
    if type(layer.halo) is not int or not 0 <= layer.halo <= MOST_HALO:
        raise InputError(f"layer '{layer.name}' of {file}: a halo of {layer.halo!r:.60}; give 0 to {MOST_HALO} cells")
    return replace(layer, compute=lambda cells, reading: _values(layer, file, cells, reading))


def _values(layer: Layer, file: str, cells: Array, reading: Reading) -> Floats:
    with said_of(f"layer '{layer.name}' of {file}"):
        values = np.asarray(layer.compute(cells, reading))
    if values.shape != cells.shape or values.dtype.kind not in "buif":
        raise InputError(
            f"layer '{layer.name}' of {file}: gives {values.dtype} of shape {values.shape} for cells of shape "
            f"{cells.shape}; give a float64 for each, NaN where there is no value"
        )
    return values.astype(np.float64, copy=False)
