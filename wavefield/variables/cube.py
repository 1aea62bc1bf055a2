"""Variables and integer codes of a cube and its frames, and of the exact fields of a simulated experiment."""

from dataclasses import replace
from enum import IntEnum, IntFlag
from typing import Any

from wavefield.variables.table import CUBE_DIMS, TABLE, Variable, register


class Quality(IntFlag):
    """Bits of the variable ``quality`` of a cube, which tell how the values at a node were obtained."""

    MEASURED = 1  # measured by matching images
    FILLED = 2  # interpolated from neighbouring nodes
    OUTSIDE = 4  # outside the field of view of the cameras
    REJECTED_CORRELATION = 8  # low correlation between images
    REJECTED_EPS = 16  # large epipolar error
    REJECTED_NEIGHBOURS = 32  # outlier among its neighbours
    TWO_FRAME_MEAN = 64  # z at mid-time or the velocity comes from fewer than four frames
    FEWER_CAMERAS = 128  # measured without a camera whose frame is missing or contradicts the others
    MASKED = 256  # covered by a mask: an object, or water hidden behind it
    REJECTED_RANGE = 512  # outside the search range, or far above the waves of the sampled frames
    WITHOUT_1 = 1024  # set with FEWER_CAMERAS: measured without the first camera of the attribute `cameras`
    WITHOUT_2 = 2048
    WITHOUT_3 = 4096
    WITHOUT_4 = 8192
    WITHOUT_5 = 16384
    WITHOUT_6 = 32768  # without the sixth or a later camera

    @classmethod
    def without(cls, number: int) -> "Quality":
        """Return the bits of `quality` at a node that was measured without one of the cameras.
        `number` is the index of this camera, from 0, in the attribute ``cameras`` of the cube."""
        return cls.FEWER_CAMERAS | cls(cls.WITHOUT_1.value << min(number, 5))


class FrameStatus(IntEnum):
    """Values of the variable ``frame_status`` of a cube, which tell whether a step was measured."""

    NOT_STARTED = 0  # not measured yet
    DONE = 1
    DONE_WITH_FAULTS = 2  # measured, but a camera's frame is missing or few nodes are valid
    FAILED = 3  # could not be measured; no values
    DISCONTINUOUS = 4  # no values: a frame of this step or next to it was lost, doubled or late


class FrameFault(IntEnum):
    """What is wrong with a frame of a camera."""

    NONE = 0
    MISSING = 1
    UNREADABLE = 2  # corrupt, truncated, or not an image
    WRONG_SIZE = 3  # its rows, columns or type differ from the other frames
    BLANK = 4  # black, or all pixels equal
    RANGE = 5  # the water moved beyond the search range; the image itself is good
    REPEATED = 6  # identical to the frame before it, which the noise of a camera rules out for a new image


AROUND = 2  # a step uses its own two frames and this many before and after them
EXACT_SIX = 7  # value of `path_frames`: the quintic through six frames gives the displacement
# Weights by `path_frames`. The displacement at mid-time is the first weight times that of the step itself,
# plus each further weight times the sum of the displacements one (two) steps earlier and later. All are exact
# for a cubic in time. Those of 6 pass less noise than those of 4 and keep 1/6 of a wave at the Nyquist
# frequency; the weights with the least noise would cancel some waves completely.
PATH_WEIGHTS: dict[int, tuple[float, ...]] = {
    2: (1.0,),
    4: (26 / 24, -1 / 24),
    6: (34 / 48, 10 / 48, -3 / 48),
    EXACT_SIX: (2134 / 1920, -116 / 1920, 9 / 1920),
}
INSTANTANEOUS = 1  # value of `path_frames`: instantaneous velocities, as of a model, not displacements / dt


def frames_of_path(code: int) -> int:
    """Return the number of frames used for a displacement, given its code in the variable ``path_frames``.
    The code is this number, except that `EXACT_SIX` stands for 6 frames."""
    return 6 if code == EXACT_SIX else code


def _cube(name: str, units: str, long_name: str, **more: Any) -> Variable:
    return Variable(name, CUBE_DIMS, units, long_name, **more)


def _flags(enum: Any) -> dict[str, Any]:
    key = "flag_masks" if issubclass(enum, IntFlag) else "flag_values"
    return {
        key: [int(member) for member in enum],
        "flag_meanings": " ".join(member.name.lower() for member in enum),
    }


register(
    Variable("time", ("time",), "s", "time at mid-step", dtype="float64", extra={"axis": "T"}),
    Variable("x", ("x",), "m", "x", dtype="float64", extra={"axis": "X"}),
    Variable("y", ("y",), "m", "y", dtype="float64", extra={"axis": "Y"}),
    Variable(
        "path_frames",
        (),
        "1",
        "frames that velocity and rate of rise come from",
        dtype="uint8",
        meaning="6: six frames, least noise; 7: six frames, exact to the fifth degree in time; 4: four "
        "frames; 2: one step; 1: instantaneous velocities. Fewer are used near lost frames and at the ends",
        extra={
            "flag_values": [1, 2, 4, 6, EXACT_SIX],
            "flag_meanings": "instantaneous one_step four_frames six_frames_smooth six_frames_exact",
        },
    ),
    _cube(
        "z",
        "m",
        "surface elevation",
        standard_name="water_surface_height_above_reference_datum",
        meaning="at mid-time, from six frames, in axes that move with the mean flow",
        extra={"ancillary_variables": "z_std z_level_std quality", "frames": 2 * AROUND + 2, "moving": 1},
    ),
    _cube(
        "z_t",
        "m s-1",
        "rate of rise of the surface",
        meaning="at a fixed node",
    ),
    *(
        _cube(
            name,
            "m s-1",
            text,
            standard_name=standard_name,
            meaning="at mid-time, along the path of the water",
            extra={"ancillary_variables": f"{name}_std quality"},
        )
        for name, text, standard_name in (
            ("u", "velocity along x", "surface_sea_water_x_velocity"),
            ("v", "velocity along y", "surface_sea_water_y_velocity"),
            ("w", "vertical velocity", "upward_sea_water_velocity"),
        )
    ),
    _cube("eps_y", "m", "epipolar error, as a distance on z = 0"),
    _cube("eps_piv", "pixel", "misfit of the cameras' displacements"),
    _cube("z_std", "m", "standard uncertainty of z", meaning="excludes `z_level_std`"),
    Variable(
        "z_level_std",
        (),
        "m",
        "standard uncertainty of z = 0",
        dtype="float64",
        meaning="common to all nodes and times; z_std excludes it",
    ),
    _cube("u_std", "m s-1", "standard uncertainty of u"),
    _cube("v_std", "m s-1", "standard uncertainty of v"),
    _cube("w_std", "m s-1", "standard uncertainty of w"),
    _cube("quality", "1", "how the values were obtained", dtype="uint16", extra=_flags(Quality)),
    Variable("frame_status", ("time",), "1", "state of each step", dtype="uint8", extra=_flags(FrameStatus)),
)

CUBE_FIELDS = tuple(name for name, row in TABLE.items() if row.dims == CUBE_DIMS)

register(
    Variable("frame", ("frame",), "1", "frame number", dtype="int64"),
    Variable("camera", ("camera",), "", "camera", dtype="str"),
    Variable(
        "frame_fault",
        ("camera", "frame"),
        "1",
        "what was wrong with a frame",
        dtype="uint8",
        extra=_flags(FrameFault),
    ),
    # more exact fields of a simulated experiment
    _cube("z_rate", "m s-1", "instantaneous rate of rise of the surface"),
    _cube("z_start", "m", "surface elevation at the step's first frame"),
    _cube("z_end", "m", "surface elevation at the step's second frame"),
    _cube("dx", "m", "displacement along x of the water whose path has its mid-point here"),
    _cube("dy", "m", "displacement along y of the water whose path has its mid-point here"),
    _cube("dz", "m", "displacement along z of the water whose path has its mid-point here"),
)

# variables of the camera images that xarray opens from an experiment file
register(
    replace(TABLE["time"], long_name="time of the frame", group="frames"),
    Variable("frame", ("time",), "1", "frame number", dtype="int64", group="frames"),
    Variable("camera", (), "", "camera", dtype="str", group="frames"),
    Variable("image", ("time", "row", "column"), "1", "image", dtype="uint8", group="frames"),
    Variable("present", ("time",), "1", "presence of a file", dtype="bool", group="frames"),
    Variable(
        "departure",
        ("time",),
        "1",
        "delay of a frame against an even clock, from time stamps, in frame intervals",
        dtype="float64",
        group="frames",
    ),
)
