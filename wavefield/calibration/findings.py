"""What a calibration has to say while it is made."""

from dataclasses import dataclass, field


@dataclass
class Findings:
    """Sentences for a person, gathered on the way."""

    # Why the rig cannot be used, and what to photograph again
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # What was left out, and what a person should know
    left_out: dict[str, int] = field(default_factory=dict)  # Points left out per view ("camera pose")

    def leave_out(self, camera: str, pose: str, points: int, why: str = "") -> None:
        """Count points that are left out, and say why."""
        view = f"{camera} {pose}"
        self.left_out[view] = self.left_out.get(view, 0) + points
        if why:
            self.notes.append(f"{view}: {why}; left out")
