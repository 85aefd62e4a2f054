"""The map as NumPy arrays in one .npz."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from terrafuse import views
from terrafuse.export.array import centres
from terrafuse.export.files import final
from terrafuse.replica import Replica
from terrafuse.types import Bounds


def write_npz(
    replica: Replica, path: Path | str, layers: Sequence[str] | None = None, bounds: Bounds | None = None
) -> None:
    """Write the layers as (H, W) float64 arrays of their names, north-up, NaN where unknown.

    With them: `x` (W,) and `y` (H,) cell centres in metres; `crs`, empty for a local frame; `layers` and `units`,
    names and their units in the same order. `numpy.load` opens it without pickle.
    """
    chosen = views.chosen_layers(replica, layers)
    window = views.window_of(replica, bounds)
    x, y = centres(replica.lattice, window)
    arrays: dict[str, Any] = {name: array[::-1] for name, array in views.mosaic(replica, chosen, window).items()}
    about: dict[str, Any] = {
        "x": x,
        "y": y,
        "crs": np.array(replica.lattice.crs or ""),
        "layers": np.array([layer.name for layer in chosen]),
        "units": np.array([layer.unit for layer in chosen]),
    }
    with final(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays, **about)
