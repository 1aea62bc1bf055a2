"""Which steps or frames of a record are sampled."""


def evenly_spaced(count: int, number: int) -> list[int]:
    """At most ``number`` of ``count`` indices: the middles of equal parts of a record."""
    return sorted({int((k + 0.5) * count / number) for k in range(number)})


def from_first_to_last(count: int, number: int) -> list[int]:
    """At most ``number`` of ``count`` indices, evenly spaced, the first and the last among them."""
    return sorted({int(k * (count - 1) / max(number - 1, 1)) for k in range(number)})
