"""The variables of a wave store beyond its spectra, from their text table."""

import re
from pathlib import Path

from wavefield.variables.table import Variable, register

_SECTION = re.compile(r"/(\w*) \(([\w, ]*)\) ?(\w*)")


def _rows(text: str) -> list[Variable]:
    """Variables of a text table: its first lines describe the form."""
    rows: list[Variable] = []
    group, dims, dtype = "", (), ""
    for line in text.replace("\n|", " |").splitlines():
        if match := _SECTION.fullmatch(line):
            group, dims, dtype = match[1], tuple(re.findall(r"\w+", match[2])), match[3] or "float64"
        elif line and not line.startswith("#"):
            name, units, long_name, meaning, family = ([*map(str.strip, line.split("|")), "", ""])[:5]
            rows.append(
                Variable(name, dims, units, long_name, dtype, meaning=meaning, group=group, family=family)
            )
    return rows


register(*_rows(Path(__file__).with_name("wave_variables.txt").read_text(encoding="utf-8")))

# groups of the wave store, in order, with the description of each in the documentation
GROUPS = {
    "spectra": "z is at frame times; nl is u . grad z. `E_komega_*` is the integral over the angle of k; the"
    " azimuthal mean is E / (2 pi k coverage). `Ez_*` is the spectrum of the elevation by each method,"
    " transfer functions in time undone (with a gain the matching windows as well).",
    "coherence": "Of z_t with w, with -u . grad z and with their sum.",
    "kinematics": "The balance z_t = w - u . grad z at sampled steps.",
    "statistics": "Distributions and moments; displacements dx, dy, dz are those over one time step.",
    "dispersion": "The theory alone where the dispersion relation could not be fitted.",
    "fusion": "Noise of stereo and of the integrated w, and their best combination.",
    "direction": "On the ridge. `isotropy` has its own omega.",
    "directional": "E(f, theta) of the elevation as wavespectra takes it:"
    " `xarray.open_dataset(store, engine='zarr', group='directional').spec`. Missing where the dispersion"
    " relation could not be fitted.",
    "higher_order": "Missing where the record holds fewer than four segments.",
}
