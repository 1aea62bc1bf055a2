"""Codes that the datasets hold: how a value came about, how far a step is, what is wrong with a frame."""

from enum import IntEnum, IntFlag


class Quality(IntFlag):
    """Bits of the cube's ``quality``."""

    MEASURED = 1  # found by matching on its own
    FILLED = 2  # interpolated from its neighbours
    OUTSIDE = 4  # outside the field seen by the cameras
    REJECTED_CORRELATION = 8
    REJECTED_EPS = 16
    REJECTED_NEIGHBOURS = 32
    TWO_FRAME_MEAN = 64  # z at mid-time, or a path, from fewer than four frames
    FEWER_CAMERAS = 128  # a camera's frame is missing, or it contradicts the others: they did the work
    MASKED = 256  # covered: not water, or hidden from the cameras by what is not
    REJECTED_RANGE = 512  # beyond what was searched, or waves far above those that were sampled
    WITHOUT_1 = 1024  # of fewer cameras: without the first of the cube's `cameras`
    WITHOUT_2 = 2048
    WITHOUT_3 = 4096
    WITHOUT_4 = 8192
    WITHOUT_5 = 16384
    WITHOUT_6 = 32768  # or one behind it

    @classmethod
    def without(cls, number: int) -> "Quality":
        """Bits of a node that the others measured: without which camera, counted from 0."""
        return cls.FEWER_CAMERAS | cls(cls.WITHOUT_1.value << min(number, 5))


class FrameStatus(IntEnum):
    """Values of ``frame_status``: the ledger of a run."""

    NOT_STARTED = 0
    DONE = 1
    DONE_WITH_FAULTS = 2
    FAILED = 3
    DISCONTINUOUS = 4  # over a lost, doubled or late frame, or beside it: no values


class FrameFault(IntEnum):
    """What is wrong with a frame."""

    NONE = 0
    MISSING = 1
    UNREADABLE = 2  # corrupt, truncated, or not an image
    WRONG_SIZE = 3  # other rows, columns or type than the rest
    BLANK = 4  # black, or all pixels equal
    RANGE = 5  # the water went further than is searched; the image itself is good
    REPEATED = 6  # bit for bit the frame before it: no camera takes the same noise twice
