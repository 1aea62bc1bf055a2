"""Units as CF writes them: products of them, and how many of one make another."""

import re

_TOKEN = re.compile(r"^([A-Za-z_]+|%)(?:\^|\*\*)?(-?\d+)?$")
# spellings of units: factor and base unit
_KNOWN = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), (1.0, "m")),
    **{"cm": (1e-2, "m"), "mm": (1e-3, "m"), "um": (1e-6, "m"), "km": (1e3, "m")},
    **dict.fromkeys(("s", "sec", "second", "seconds"), (1.0, "s")),
    **{"ms": (1e-3, "s"), "min": (60.0, "s")},
    **dict.fromkeys(("pixel", "pixels", "px"), (1.0, "pixel")),
}


def _powers(unit: str) -> dict[str, int]:
    out: dict[str, int] = {}
    for token in unit.replace("/", " /").split():
        sign = -1 if token.startswith("/") else 1
        match = _TOKEN.match(token.lstrip("/"))
        if match:
            name = match.group(1)
            out[name] = out.get(name, 0) + sign * int(match.group(2) or 1)
        elif token != "1":
            raise ValueError(f"{unit!r} is no product of units")
    return out


def product(*factors: tuple[str, int]) -> str:
    """Multiply powers of units, (unit, power) each; radians last, as in m3 s-1 rad-2."""
    powers: dict[str, int] = {}
    for unit, power in factors:
        for name, exponent in _powers(unit).items():
            powers[name] = powers.get(name, 0) + exponent * power
    order = sorted(powers, key=lambda name: (name == "rad", [*powers].index(name)))
    out = [name if powers[name] == 1 else f"{name}{powers[name]}" for name in order if powers[name]]
    return " ".join(out) or "1"


def factor(given: str, requested: str) -> float | None:
    """How many of the requested unit a given one is (cm/s in m s-1: 0.01); None if they do not convert."""
    scale = 1.0
    left: dict[str, int] = {}
    for unit, sign in ((given, 1), (requested, -1)):
        try:
            powers = _powers(unit)
        except ValueError:
            return None
        for name, power in powers.items():
            size, base = _KNOWN.get(name, (1.0, name))
            scale *= size ** (sign * power)
            left[base] = left.get(base, 0) + sign * power
    return None if any(left.values()) else scale
