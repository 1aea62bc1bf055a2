"""Problems and notes of a calibration, collected while it is made."""

from dataclasses import dataclass, field


@dataclass
class Findings:
    """Sentences for the user."""

    problems: list[str] = field(default_factory=list)  # Why the rig cannot be used, and what to do
    notes: list[str] = field(default_factory=list)  # What was left out, and other remarks
    left_out: dict[str, int] = field(default_factory=dict)  # Points left out per view ("camera pose")

    def leave_out(self, camera: str, pose: str, points: int, reason: str = "") -> None:
        """Count points that are left out, and note the reason."""
        view = f"{camera} {pose}"
        self.left_out[view] = self.left_out.get(view, 0) + points
        if reason:
            self.notes.append(f"{view}: {reason}; left out")
