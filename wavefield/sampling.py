"""Indices of the steps or frames of a record that are sampled."""


def evenly_spaced(count: int, number: int) -> list[int]:
    """Return at most `number` of the indices 0 to `count` - 1: the middles of `number` equal parts.

    Examples
    --------
    >>> evenly_spaced(100, 4), evenly_spaced(2, 4)
    ([12, 37, 62, 87], [0, 1])
    """
    return sorted({int((k + 0.5) * count / number) for k in range(number)})


def from_first_to_last(count: int, number: int) -> list[int]:
    """Return at most `number` of the indices 0 to `count` - 1, evenly spaced from the first to the last.

    Examples
    --------
    >>> from_first_to_last(100, 3), from_first_to_last(2, 3)
    ([0, 49, 99], [0, 1])
    """
    return sorted({int(k * (count - 1) / max(number - 1, 1)) for k in range(number)})
