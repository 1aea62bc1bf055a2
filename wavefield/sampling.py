"""Choose steps or frames of a record for sampling, by index."""


def evenly_spaced(count: int, number: int) -> list[int]:
    """Return at most `number` of the indices 0 to `count` - 1: the middles of `number` equal parts."""
    return sorted({int((k + 0.5) * count / number) for k in range(number)})


def from_first_to_last(count: int, number: int) -> list[int]:
    """Return at most `number` of the indices 0 to `count` - 1, evenly spaced from the first to the last."""
    return sorted({int(k * (count - 1) / max(number - 1, 1)) for k in range(number)})
