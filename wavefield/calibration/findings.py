"""What a calibration has to say while it is made."""

from dataclasses import dataclass, field


@dataclass
class Findings:
    """Sentences for a person, gathered on the way.

    Parameters
    ----------
    problems : list of str
        Why the rig cannot be used, and what to photograph again.
    notes : list of str
        What was left out, and what a person should know.
    left_out : dict of str to int
        Points left out per view ("camera pose").
    """

    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    left_out: dict[str, int] = field(default_factory=dict)

    def leave_out(self, camera: str, pose: str, points: int, why: str = "") -> None:
        """Count points that are left out, and say why.

        Parameters
        ----------
        camera, pose : str
            The view.
        points : int
            How many of its points.
        why : str
            For a person; nothing is said if empty.
        """
        view = f"{camera} {pose}"
        self.left_out[view] = self.left_out.get(view, 0) + points
        if why:
            self.notes.append(f"{view}: {why}; left out")
