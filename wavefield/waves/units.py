"""Units of products: how the unit of a spectrum comes from the unit of its field."""

import re

_TOKEN = re.compile(r"^([A-Za-z]+)(-?\d+)?$")


def product(*factors: tuple[str, int]) -> str:
    """Multiply powers of units.

    Parameters
    ----------
    *factors : tuple of (str, int)
        A unit as in CF ("m s-1"; "1" for a pure number) and its power.

    Returns
    -------
    str
        The product in the same notation.

    Examples
    --------
    >>> product(("m s-1", 2), ("rad m-1", -1), ("rad s-1", -1))
    'm3 s-1 rad-2'
    """
    powers: dict[str, int] = {}
    for unit, power in factors:
        for token in unit.split():
            match = _TOKEN.match(token)
            if match:
                name, exponent = match.group(1), int(match.group(2) or 1)
                powers[name] = powers.get(name, 0) + exponent * power
    order = sorted(powers, key=lambda name: (name == "rad", [*powers].index(name)))
    out = [name if powers[name] == 1 else f"{name}{powers[name]}" for name in order if powers[name]]
    return " ".join(out) or "1"
