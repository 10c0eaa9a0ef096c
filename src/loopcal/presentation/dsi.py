"""Quantities in D-SI, the form of numbers and units in digital calibration certificates.

D-SI names units by words with a backslash and exponents by ``\\tothe{}`` (PTB, Digital System of
Units; BIPM SI brochure, 9th edition). A unit outside the SI, such as the inch, is converted.
"""

from __future__ import annotations

from dataclasses import dataclass

from loopcal.units import difference_to_si, to_si, unit

_NAMES = {
    "m": r"\metre", "cm": r"\centi\metre", "mm": r"\milli\metre",
    "um": r"\micro\metre", "nm": r"\nano\metre",
    "rad": r"\radian", "mrad": r"\milli\radian", "urad": r"\micro\radian",
    "deg": r"\degree", "arcmin": r"\arcminute", "arcsec": r"\arcsecond",
    "1": r"\one", "kg": r"\kilogram", "g": r"\gram", "N": r"\newton", "s": r"\second",
    "K": r"\kelvin", "mK": r"\milli\kelvin", "degC": r"\degreecelsius",
}  # fmt: skip


@dataclass(frozen=True)
class DsiQuantity:
    """A value and its sizes (uncertainties, which are differences) in a D-SI unit."""

    value: float
    unit: str
    sizes: tuple[float, ...] = ()


def in_dsi(value: float, name: str, *sizes: float) -> DsiQuantity:
    r"""A value [unit `name`] and uncertainties in D-SI; in SI units where D-SI has no such unit.

    >>> in_dsi(0.3, "mm", 0.01)
    DsiQuantity(value=0.3, unit='\\milli\\metre', sizes=(0.01,))
    >>> in_dsi(2.0, "urad/(N m)").unit
    '\\micro\\radian\\newton\\tothe{-1}\\metre\\tothe{-1}'
    >>> in_dsi(1.0, "in")
    DsiQuantity(value=0.0254, unit='\\metre', sizes=())
    """
    named = _named(unit(name).name)
    if named is not None:
        return DsiQuantity(value, named, sizes)
    si = _named(unit(name).si)
    assert si is not None  # every SI unit of ours has a name
    converted = tuple(float(difference_to_si(size, name)) for size in sizes)
    return DsiQuantity(float(to_si(value, name)), si, converted)


def _named(name: str) -> str | None:
    above, _, below = name.partition("/")
    parts = [_NAMES.get(above), *(_NAMES.get(part) for part in below.strip("()").split())]
    if None in parts:
        return None
    first, *others = (str(part) for part in parts)
    first = "" if others and first == _NAMES["1"] else first
    return first + "".join(rf"{part}\tothe{{-1}}" for part in others)
