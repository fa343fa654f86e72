"""How a run's coordinates are called."""


def name_coordinates(d: int) -> tuple[str, ...]:
    """The names of ``d`` coordinates, from 1 as in figures.

    Columns of files count from 0, as arrays do.

    Example:
        >>> name_coordinates(2)
        ('q1', 'q2')
    """
    return tuple(f"q{number}" for number in range(1, d + 1))
