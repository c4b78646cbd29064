"""Gwyddion's own numbers, through its library (GPL; Debian: libgwyddion2-0), which is only called.

Nothing of the desktop program runs: libgwyprocess is a plain C library.
"""

from __future__ import annotations

import ctypes
from ctypes import byref, c_double, c_int, c_void_p

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
EXCLUDE, IGNORE = 0, 2
"""How Gwyddion uses a mask."""


class Gwyddion:
    """The library, loaded once.

    Raises
    ------
    OSError
        It is not installed.
    """

    def __init__(self) -> None:
        # libgwyprocess takes symbols from libgwyddion without naming it.
        ctypes.CDLL("libgwyddion2.so.0", ctypes.RTLD_GLOBAL)
        self._library = library = ctypes.CDLL("libgwyprocess2.so.0")
        library.gwy_process_type_init()
        library.gwy_data_field_new.restype = c_void_p
        library.gwy_data_field_new.argtypes = [c_int, c_int, c_double, c_double, c_int]
        library.gwy_data_field_get_data.restype = ctypes.POINTER(c_double)
        library.gwy_data_field_get_data.argtypes = [c_void_p]
        library.gwy_data_line_new.restype = c_void_p
        library.gwy_data_line_new.argtypes = [c_int, c_double, c_int]
        library.gwy_data_line_get_data.restype = ctypes.POINTER(c_double)
        library.gwy_data_line_get_data.argtypes = [c_void_p]

    def heights(self, z_um: FloatArray, pitch_um: float) -> dict[str, float]:
        """Sa, Sq, Ssk, Sku, Sz, Sdq, Sdr of the valid pixels."""
        field, mask = self._field(z_um, pitch_um), self._mask(z_um)
        mode = EXCLUDE if mask else IGNORE
        rows, columns = z_um.shape
        area = (c_void_p(field), c_void_p(mask), c_int(mode), c_int(0), c_int(0), c_int(columns), c_int(rows))
        found = [c_double() for _ in range(5)]
        self._library.gwy_data_field_area_get_stats_mask(*area, *(byref(one) for one in found))
        _, ra, rms, skew, kurtosis = (one.value for one in found)
        low, high = c_double(), c_double()
        self._library.gwy_data_field_area_get_min_max_mask(*area, byref(low), byref(high))
        surface = self._double("gwy_data_field_area_get_surface_area_mask", *area)
        slope = self._double("gwy_data_field_area_get_surface_slope_mask", *area)
        projected = np.isfinite(z_um).sum() * pitch_um**2
        return {
            "Sa": ra,
            "Sq": rms,
            "Ssk": skew,
            "Sku": kurtosis + 3.0,
            "Sz": high.value - low.value,
            "Sdq": slope,
            "Sdr": 100.0 * (surface / projected - 1.0),
        }

    def levelled(self, z_um: FloatArray, degree: int) -> FloatArray:
        """Heights minus the least-squares polynomial of that total degree over the valid pixels."""
        field, mask = self._field(z_um, 1.0), self._mask(z_um)
        terms = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
        powers = (c_int * (2 * len(terms)))(*[power for term in terms for power in term])
        rows, columns = z_um.shape
        place = (c_int(0), c_int(0), c_int(columns), c_int(rows), c_int(len(terms)), powers)
        fit = self._library.gwy_data_field_area_fit_poly
        fit.restype = ctypes.POINTER(c_double)
        coefficients = fit(c_void_p(field), c_void_p(mask), *place, c_int(1), None)
        self._library.gwy_data_field_area_subtract_poly(c_void_p(field), *place, coefficients)
        return np.where(np.isfinite(z_um), self._values(field, z_um.shape), np.nan)

    def filtered(self, z_um: FloatArray, sigma_px: float) -> FloatArray:
        """Gaussian mean with Gwyddion's own treatment of borders; it does not know holes."""
        field = self._field(z_um, 1.0)
        self._library.gwy_data_field_filter_gaussian(c_void_p(field), c_double(sigma_px))
        return self._values(field, z_um.shape)

    def profile(self, z_um: FloatArray, step_um: float) -> dict[str, float]:
        """Pa, Pq, Psk, Pku, Pt of a line."""
        line = self._library.gwy_data_line_new(z_um.size, z_um.size * step_um, 0)
        data = np.ctypeslib.as_array(self._library.gwy_data_line_get_data(line), (z_um.size,))
        data[:] = z_um
        names = {"Pa": "ra", "Pq": "rms", "Psk": "skew", "Pku": "kurtosis", "max": "max", "min": "min"}
        found = {name: self._double(f"gwy_data_line_get_{call}", c_void_p(line)) for name, call in names.items()}
        return {name: found[name] for name in ("Pa", "Pq", "Psk")} | {
            "Pku": found["Pku"] + 3.0,
            "Pt": found["max"] - found["min"],
        }

    def _double(self, name: str, *arguments: object) -> float:
        function = getattr(self._library, name)
        function.restype = c_double
        return float(function(*arguments))

    def _field(self, values: FloatArray, pitch_um: float) -> int:
        rows, columns = values.shape
        field = self._library.gwy_data_field_new(columns, rows, columns * pitch_um, rows * pitch_um, 0)
        self._view(field, values.shape)[:] = np.nan_to_num(values)
        return int(field)

    def _mask(self, values: FloatArray) -> int | None:
        """A field that is 1 where a pixel is invalid; None when all are valid."""
        invalid = ~np.isfinite(values)
        return self._field(invalid.astype(np.float64), 1.0) if invalid.any() else None

    def _view(self, field: int, shape: tuple[int, ...]) -> FloatArray:
        return np.ctypeslib.as_array(self._library.gwy_data_field_get_data(field), shape)

    def _values(self, field: int, shape: tuple[int, ...]) -> FloatArray:
        self._library.gwy_data_field_invalidate(c_void_p(field))
        return self._view(field, shape).copy()
