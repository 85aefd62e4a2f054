import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from terrafuse.kernels.grouping import by_tile, by_tile_reference

index = st.integers(-300, 300) | st.integers(-(2**40), 2**40)


@given(st.lists(st.tuples(index, index), max_size=60), st.integers(1, 40))
def test_by_tile_equals_its_reference(cells: list[tuple[int, int]], side: int) -> None:
    i, j = np.array(cells, np.int64).reshape(-1, 2).T.copy()
    keys, starts, at, order = by_tile(i, j, side)
    found = {
        (int(x), int(y)): list(zip(at[a:b].tolist(), order[a:b].tolist(), strict=True))
        for (x, y), a, b in zip(keys, starts[:-1], starts[1:], strict=True)
    }
    expected = by_tile_reference(i, j, side)
    assert found == expected
    assert list(found) == list(expected)
