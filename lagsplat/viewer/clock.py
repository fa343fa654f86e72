"""How many steps of the dynamics are due: model time runs with the wall's, or with a multiple of it."""

LATEST_S = 0.25
"""Of the wall: what is due for longer is forgotten, so that a pause of the machine is not made up in a
leap."""


class Clock:
    """Model time in steps of ``dt_s``, ``speed`` times as fast as the wall's clock [s]."""

    def __init__(self, dt_s: float, *, now_s: float) -> None:
        self.dt_s, self.speed = dt_s, 1.0
        self.owed, self.seen_s, self.forgotten = 0.0, now_s, 0

    def due(self, now_s: float, *, running: bool = True) -> int:
        """Whole steps due by now; they count as done. While not ``running`` none falls due."""
        passed, self.seen_s = max(0.0, now_s - self.seen_s), now_s
        if not running:
            return 0
        self.owed += passed * self.speed / self.dt_s
        most = max(1.0, LATEST_S * self.speed / self.dt_s)
        if self.owed > most:
            self.forgotten += int(self.owed - most)
            self.owed = most
        steps = int(self.owed + 1e-9)  # a step is due although sums of times are rounded
        self.owed = max(0.0, self.owed - steps)
        return steps

    def wait_s(self) -> float:
        """How long until the next step falls due."""
        return (1.0 - self.owed) * self.dt_s / self.speed
