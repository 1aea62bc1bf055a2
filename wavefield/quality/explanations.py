"""What each remark of a verdict means, how it is found, and what to do: the text of `wavefield explain`."""

EXPLANATIONS = {
    # cameras
    "mirrored": (
        "A camera matches the others only when its images are turned or flipped. Patches of the water are "
        "compared as the images are and in every orientation. Export the images as the camera showed them, or"
        " calibrate with target images of the same orientation."
    ),
    "swapped": (
        "Two cameras match the others only when their images are exchanged: folders or names of the rig were "
        "mixed up. Exchange their `images` in the experiment file."
    ),
    "late": (
        "A camera matches the others only when each of its frames is compared with an earlier one of theirs: "
        "its numbers are shifted. Subtract the stated number from its `offset`."
    ),
    "early": (
        "A camera matches the others only when each of its frames is compared with a later one of theirs: its"
        " numbers are shifted. Add the stated number to its `offset`."
    ),
    "reversed": (
        "A camera matches the others only when its record is run backwards. Number its images in the order of"
        " time."
    ),
    "short-waves": (
        "The beads move beside the measured field, and in all cameras alike: by waves shorter than some 2.5 "
        "blocks of the images. Their elevation and velocity are contained in the standard uncertainties, not "
        "in z, u, v, w. Smaller pixels resolve them."
    ),
    "contradicts": (
        "A camera matches no other one, in no orientation or order that was tried. Usual causes: the rig is "
        "not that of these images, blur, too little light, frames of other moments. `wavefield check "
        "EXPERIMENT --pairs` compares the pairs."
    ),
    "disagree": (
        "No two cameras match: at most a few patches of one image are found in another. Usual causes: a rig"
        " of other images, frames of other moments (`offset`), water without texture."
    ),
    "covered": (
        "An image has no texture where those of the others have: something is in front of the camera, or "
        "light is missing. That part of the water is measured by the others, or not at all. Draw a lasting "
        "object as a `mask:`."
    ),
    "out-of-focus": (
        "The beads' images of a camera are wider than those of the others, in pixels and on the water. Short "
        "waves are lost first. Focus it, or leave the camera out (`surface: pairs`, `velocity: cameras`)."
    ),
    "moved": (
        "Sight lines of the same water miss one another by more than the calibration explains (epipolar "
        "error): a camera has moved since, or the rig is another's. A still-water record corrects it "
        "(`rest:`, or `wavefield refine`); else calibrate again."
    ),
    "knocked": (
        "The epipolar error jumps within the record: a camera was moved at the stated frame. Measure the two "
        "parts by themselves (`frames: {first, last}`), the second with a rig of `wavefield refine`."
    ),
    "shaking": (
        "The epipolar error varies from step to step: cameras tilt or roll on their mounts. z, u, v and w "
        "have errors of the stated size in pixels. `settings: {vibration: correct}` turns images back."
    ),
    "jitter": (
        "Either the cameras' images move against each other along the line on which the cameras are placed;"
        " the uncertainties include it. Or the frames were not taken at the times assumed, so that all "
        "displacements of a step have one wrong factor; state the time stamps (`times:`)."
    ),
    "turned-back": (
        "For information: images were turned back by the stated shift, as the settings request (`vibration: "
        "correct`)."
    ),
    "delayed": (
        "A camera takes its frames at another moment than the others. The delay follows from the epipolar "
        "error beside the motion of the water. Trigger all cameras by one signal with one exposure time."
    ),
    "rolling-shutter": (
        "The rows of the images are exposed one after the other: the delay grows along the image. Use cameras"
        " with a global shutter, or slower motion."
    ),
    "left-out": (
        "Nodes were measured without this camera: its frame was missing, or it was inconsistent with the "
        "others there. Check for drops on its window, reflections, focus, late frames."
    ),
    # recordings and frames
    "longer": (
        "Many frames of a camera are before or after the record, where another has none. Either images of the"
        " other camera are missing, or their numbers differ (`offset`)."
    ),
    "duration": (
        "The record is implausibly long: `frame_rate` is not in Hz, or the frames are not numbered one by "
        "one."
    ),
    "frame-rate": (
        "A recording states another frame rate than the experiment file. Velocities are proportional to it. "
        "Leave `frame_rate` out to take the recording's."
    ),
    "playback-rate": (
        "The frame rate is the one that a video states, because the experiment file has the same or none. It "
        "is the rate at which the video is played: for a camera that recorded faster or slower, state "
        "`frame_rate`. Velocities are proportional to it."
    ),
    "dropped-images": (
        "The camera lost images, by its clock. Their places stay empty and no step is measured across them. "
        "Record to the camera's memory, to a faster disk, or at a lower rate."
    ),
    "uneven-times": (
        "Some intervals between images are not multiples of the nominal one, which velocities assume: they "
        "are wrong there. Use an even part of the record (`frames:`), or state the time stamps (`times:`)."
    ),
    "drift": (
        "The clocks of two cameras drift apart. Harmless if one trigger drives both; else frames with the "
        "same number were taken at different moments."
    ),
    "unreadable": (
        "A file is damaged or of another format: frames, or the table of the wave probes. Frames that cannot "
        "be read count as missing; a run ignores probes that cannot be read. Copy the frames again; correct "
        "the table, or name its columns in `probes:`."
    ),
    "blank": "Frames of which all pixels are equal: lens covered, light off, or an export that failed.",
    "other-size": (
        "Frames of another size or type than the others of their camera. Put the frames of one setting into "
        "one record."
    ),
    "frozen": (
        "Frames that equal the one before them in every pixel: the recorder repeats an image where it lost "
        "one. They count as missing."
    ),
    "missing-frames": (
        "Numbers without a file. Their steps are not measured; the others keep their times. Copy them, or "
        "state a range that is complete (`frames:`)."
    ),
    "few-usable-steps": "Fewer than half of the steps have two usable frames of every camera.",
    "few-common-steps": (
        "Fewer than half of the steps have a file of every camera at both moments: files are missing, or the "
        "cameras number their frames differently (`offset`)."
    ),
    "bad-frames": (
        "Steps with bad frames around them are measured with fewer frames: less accurately. Copy these frames"
        " again and repeat the command: only their steps are measured again."
    ),
    "failed-steps": "Steps that could not be measured; `wavefield status` lists the frames and the reasons.",
    # rig and grid
    "levelled": (
        "For information: z = 0 is the water at rest, found in the still-water record, or the mean surface "
        "of moving water."
    ),
    "not-levelled": (
        "The experiment names a still-water record (`rest:`), but the rig was made without it. Run `wavefield"
        " calibrate` again, or `wavefield refine` for the rig of another program."
    ),
    "no-rest": (
        "Without a still-water record z = 0 is the plane of the target. Visible beads are above the water "
        "(beads of 3 to 5 mm by about 0.4 mm), which lowers u and v of 12 cm waves by about 2 %; "
        "`z_level_std` of the cube is the uncertainty of z = 0, and z_std does not contain it. Record some "
        "twenty frames of still, seeded water and name them with the key `rest`."
    ),
    "light-sheet": (
        "How z = 0 relates to the light sheet. `wavefield rig sheet` finds the sheet by the particles "
        "themselves."
    ),
    "coverage": (
        "All cameras see only a part of the grid together. `grid` is in metres; `grid: auto` takes what all "
        "cameras see."
    ),
    "room": "The disk has less room than the cube will need. Free some, or write elsewhere with -o.",
    # fields
    "holes": (
        "Few of the nodes in view were measured; the others are filled from their neighbours, or empty. The "
        "variable `quality` gives the reason at each node. Usual causes: seeding, light, ranges of search."
    ),
    "eps": (
        "The cameras are inconsistent on the motion of the water: eps', what is left of their displacements "
        "after u, v, w were fitted, is large. Usual causes: frames of different moments or order, a camera "
        "that moved."
    ),
    "depth": "`water: depth` contradicts the surface or the cameras' distance. It is in metres.",
    "speed": (
        "The water would move faster than any wave: `frame_rate` is not in Hz, or the rig is not in metres."
    ),
    "kinematics": (
        "The kinematic condition is violated: z_t - w + (u, v)·∇z exceeds its standard uncertainty."
        " Check frame rate, synchronisation and seeding; waves may be too short for the images."
    ),
    "discontinuous-steps": (
        "Steps that do not continue their neighbours: frames were duplicated or lost in all cameras at once. "
        "Leave these steps out of the analysis."
    ),
    # probes
    "no-overlap": (
        "The probes and the cameras share no time: their clocks begin at different moments. State the "
        "difference as `clock` in `probes:`, s."
    ),
    "sign": "A probe falls where the measured surface rises. Turn it: `factor: -1` in `probes:`.",
    "clock": (
        "A probe shows the measured surface earlier or later. Correct `clock` in `probes:`, or the cameras' "
        "`offset`."
    ),
    "unit": (
        "A probe is a power of ten larger or smaller than the measured surface. State its unit: `unit: mm` in"
        " `probes:`."
    ),
    "gain": (
        "A probe differs from the measured surface by a constant factor: calibrate it, or state its `factor`;"
        " or the rig's scale is wrong (`mesh`)."
    ),
    "position": "A probe fits the measured surface at another place than stated. Correct its place.",
    "unlike": (
        "A probe does not resemble the measured surface near it at any time. Check its place, that its file"
        " belongs to this record, and that it was in the water."
    ),
}


def first_sentence(text: str) -> str:
    """The first sentence of an explanation.

    Examples
    --------
    >>> first_sentence("It is blurred. Focus it.")
    'It is blurred.'
    """
    return text.partition(". ")[0].rstrip(".") + "."
