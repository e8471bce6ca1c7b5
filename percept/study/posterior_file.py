"""The posterior as a netCDF file that ArviZ and xarray open as a DataTree."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import percept
from percept.study.posterior import Groups


def write_posterior(groups: Groups, path: Path) -> None:
    """Write groups of named arrays, each with its coordinates.

    xarray would write the same, after it has imported every array library of the machine to ask whether the
    arrays are of its kind: dask, distributed and pint take longer than the file.
    """
    import h5netcdf

    with h5netcdf.File(path, "w") as file:
        for name, arrays in groups.arrays.items():
            node = file.create_group(name)
            node.attrs["creation_library"] = "percept"
            node.attrs["creation_library_version"] = percept.__version__
            for variable, values in arrays.items():
                dims = ("chain", "draw", *groups.dims.get(variable, ()))
                for dim, size in zip(dims, values.shape, strict=True):
                    if dim not in node.dimensions:
                        _add_dimension(node, dim, size, groups.coords.get(dim))
                node.create_variable(variable, dims, data=np.ascontiguousarray(values))


def _add_dimension(node: Any, dim: str, size: int, labels: list[str] | None) -> None:
    """Add a dimension and its coordinates: numbers from zero where it has no labels."""
    node.dimensions[dim] = size
    if labels is None:
        node.create_variable(dim, (dim,), data=np.arange(size))
    else:
        node.create_variable(dim, (dim,), dtype=_text(), data=np.array(labels, dtype=object))


def _text() -> Any:
    import h5py  # type: ignore[import-untyped]

    return h5py.string_dtype()
