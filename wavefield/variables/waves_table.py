"""The table of variables of a wave store; rules name the spectra, and a text file lists the others."""

import re
from pathlib import Path
from typing import Any

from wavefield.variables.table import Variable, product, register

K_UNITS, OMEGA_UNITS = "rad m-1", "rad s-1"

# quantities that have spectra: units and meaning
FIELD_UNITS = {"z": "m"} | dict.fromkeys(("z_t", "rise", "u", "v", "w", "nl"), "m s-1")
FIELD_TEXTS = {
    "z": "surface elevation at frame times",
    "z_t": "rate of rise of the surface",
    "rise": "rate of rise in the frame that moves with the mean current U, z_t + U . grad z",
    "u": "velocity along x",
    "v": "velocity along y",
    "w": "vertical velocity",
    "nl": "nonlinear term (u - U) . grad z, U the mean current",
}
ELEVATION_UNITS = "m2 s rad-1"


def density_units(unit: str, *over: str) -> str:
    """Return the units of the power spectral density of a quantity, given its `unit` and the axes `over`.
    An axis is "k" (wavenumber, rad/m) or "omega" (angular frequency, rad/s).

    Examples
    --------
    >>> density_units("m", "k", "omega")
    'm3 s rad-2'
    """
    axes = {"k": K_UNITS, "omega": OMEGA_UNITS}
    return product((unit, 2), *((axes[name], -1) for name in over))


def rows(group: str, dims: tuple[str, ...], *rows: tuple[Any, ...], **more: Any) -> None:
    """Add variables of one group, with the dimensions `dims`, to the table of variables.
    Each row is (name, units, long_name) or (name, units, long_name, meaning). `more` holds further fields of
    `Variable` for all rows; the type is float64 by default."""
    for name, units, text, *meaning in rows:
        note = meaning[0] if meaning else ""
        register(Variable(name, dims, units, text, meaning=note, group=group, **{"dtype": "float64"} | more))


_TRUST = "where the spectrum can be trusted"
LOW, HIGH = "lower end of the 95 % interval, factor", "upper end of the 95 % interval, factor"

# ---- axes ----
rows("", ("omega",), ("omega", OMEGA_UNITS, "angular frequency"), ("frequency", "Hz", "frequency"))
rows("", ("k",), ("k", K_UNITS, "wavenumber"), ("cycles", "m-1", "wavenumber / 2 pi"))
rows("", ("kx",), ("kx", K_UNITS, "wavenumber along x"))
rows("", ("ky",), ("ky", K_UNITS, "wavenumber along y"))
rows("", ("omega_map",), ("omega_map", OMEGA_UNITS, "angular frequency of the map"))
rows("", ("omega1",), ("omega1", OMEGA_UNITS, "angular frequency"))
rows("", ("omega2",), ("omega2", OMEGA_UNITS, "angular frequency"))
rows("", ("theta",), ("theta", "rad", "direction of propagation, from x towards y"))
rows("", ("step",), ("step", "1", "step of the cube"), dtype="int64")
rows("", ("band",), ("band_frequency", "Hz", "middle of the band"))
rows("", ("bin",), ("bin", "1", "(value - mean) / standard deviation"))
_quantities = "; ".join(f"{name}: {text}" for name, text in FIELD_TEXTS.items())
rows("", ("quantity",), ("quantity", "", "quantity of the spectrum", _quantities), dtype="str")
rows("", ("quantity_map",), ("quantity_map", "", "quantity of the map"), dtype="str")
_moments = "elevation, and displacement over one time step"
rows("statistics", ("quantity",), ("quantity", "", _moments), dtype="str")
rows("", ("pair",), ("pair", "", "quantities of the cross spectrum, a*b"), dtype="str")
_terms = "w; nl: -(u - U) . grad z; tot: their sum"
rows("", ("term",), ("term", "", "term of the kinematic condition", _terms), dtype="str")
_sources = (
    "stereo; w: integrated w; cross: cross spectrum of stereo and integrated w; fusion: the best combination,"
    " noise taken off"
)
rows("", ("source",), ("source", "", "method that gives the elevation", _sources), dtype="str")

# ---- a spectrum of any field ----
for _shape, _dims, _text in (
    ("plane", ("omega", "ky", "kx"), "power spectrum"),
    ("komega", ("omega", "k"), "E(k, omega)"),
    ("k", ("k",), "E(k)"),
    ("omega", ("omega",), "E(omega)"),
):
    rows(_shape, _dims, ("E", "", _text))
rows("maps", ("omega_map", "ky", "kx"), ("E", "", "E(ky, kx)"))
rows("", ("omega", "k"), ("dof", "1", "degrees of freedom"), ("low", "1", LOW), ("high", "1", HIGH))
rows("", ("omega",), ("dof_omega", "1", "degrees of freedom of E(omega)"))
rows("", ("k",), ("dof_k", "1", "degrees of freedom of E(k)"))
rows("", ("omega", "k"), ("valid", "1", _TRUST), dtype="bool")
rows(
    "",
    ("k",),
    ("coverage", "1", "fraction of the ring inside the sampled plane"),
    ("cells", "1", "independent cells of the ring", "for energy spread evenly over it"),
)


# ---- cross spectra, and /spectra ----
def _density_units(*over: str) -> str:
    return f"{density_units('m s-1', *over)}; z: {density_units('m', *over)}"


for _end, _text in (("", "E(k, omega)"), ("_k", "E(k)"), ("_omega", "E(omega)")):
    _dims = (_end[1:],) if _end else ("omega", "k")
    _of_quantity, _units = ("quantity", *_dims), _density_units(*reversed(_dims))
    rows("spectra", _of_quantity, (f"E{_end}", _units, f"{_text} of each quantity"))
    _dof = f"degrees of freedom of {_text}"
    _interval = ((f"dof{_end}", "1", _dof), (f"low{_end}", "1", LOW), (f"high{_end}", "1", HIGH))
    rows("spectra", _of_quantity, *_interval)
_valid_k = (
    "where the measurement keeps at least half of the amplitude",
    "spectra are corrected there; only with a gain; false for `rise` and `nl`",
)
rows("spectra", ("quantity", "k"), ("valid_k", "1", *_valid_k), dtype="bool")
rows(
    "cross",
    ("pair", "omega", "k"),
    (
        "S",
        "",
        "cross spectrum over k and omega",
        "conj of the first times the second, for waves exp(i (k . x - omega t)); the units of both, times"
        " m s rad-2",
    ),
    dtype="complex128",
)
rows("cross", ("pair", "omega", "k"), ("samples", "1", "independent samples of the cross spectrum"))
_samples = "independent samples of the cross spectrum, summed over omega"
rows("cross", ("pair", "k"), ("samples_k", "1", _samples))
rows("spectra", ("omega", "k"), ("valid", "1", _TRUST), dtype="bool")
for _name, _dims, _valid in (
    ("Ez", ("source", "omega"), "right within a factor 2"),
    ("Ez_probes", ("omega",), _TRUST),
):
    _end = _name.removeprefix("Ez_")
    _text = "elevation spectrum" if _name == "Ez" else "elevation spectrum, mean of the probes"
    rows("spectra", _dims, (_name, ELEVATION_UNITS, _text))
    rows("spectra", _dims, (f"dof_{_end}", "1", "degrees of freedom"))
    rows("spectra", _dims, (f"low_{_end}", "1", LOW), (f"high_{_end}", "1", HIGH))
    rows("spectra", _dims, (f"valid_{_end}", "1", _valid), dtype="bool")
rows("spectra", ("probe", "omega"), ("Ez_probe", ELEVATION_UNITS, "elevation spectrum of each probe"))
rows(
    "spectra",
    ("quantity_map", "omega_map", "ky", "kx"),
    (
        "E_kxky",
        _density_units("k", "k", "omega"),
        "E(ky, kx) of z and w",
        "at chosen frequencies, one of them the 2.8 Hz of Aubourg et al.",
    ),
)

# ---- /coherence ----
rows("coherence", ("k",), ("valid", "1", "where the waves exceed the noise"), dtype="bool")
for _ending, _dims in (("", ("k",)), ("_komega", ("omega", "k"))):
    _common = "complex, with the real part a mean over both signs of omega; `w` and `nl` add up to `tot`"
    rows(
        "coherence",
        ("term", *_dims),
        (
            f"C{_ending}",
            "1",
            "complex coherence of z_t + U . grad z with the term, with one normalisation for all terms",
            _common,
        ),
        dtype="complex128",
        family="C",
    )
    for _name, _text, _note in (
        ("gamma2", "coherence of z_t with the term, magnitude squared", ""),
        (
            "samples",
            "effective independent samples",
            "small where both signals have their energy in the same few wave vectors of a ring",
        ),
        ("level", "gamma2 that unrelated signals exceed in 5 % of cases", ""),
    ):
        rows("coherence", ("term", *_dims), (f"{_name}{_ending}", "1", _text, _note), family=_name)


_SECTION = re.compile(r"/(\w*) \(([\w, ]*)\) ?(\w*)")


def _rows(text: str) -> list[Variable]:
    """Return the variables listed in the text of `wave_variables.txt`, which explains its format."""
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
    "spectra": "The quantity `z` is at frame times, not midway between two frames; `nl` is the nonlinear"
    " term (u - U) . grad z; `rise` is z_t + U . grad z.\n\n`E` is integrated over the direction of k. For"
    " the mean over directions, divide it by 2 pi k `coverage`; `coverage` is the fraction of the ring of"
    " wavenumber k inside the sampled plane.\n\n`Ez` contains one elevation spectrum per method (dimension"
    " `source`): `stereo`, `w` (integrated w), `cross` (their cross spectrum) and `fusion` (their best"
    " combination). They are corrected for the response in time and, with a gain, in space.",
    "coherence": "The rate of rise z_t + U . grad z is compared with each `term`: `w`, `nl`"
    " (-(u - U) . grad z) and their sum `tot`. `gamma2` is the squared coherence. For unrelated signals its"
    " mean is 1 / `samples`, and it exceeds `level` in 5 % of cases.",
    "kinematics": "How well the fields satisfy the kinematic condition z_t = w - u . grad z.",
    "statistics": "Distributions and moments of z and of the displacements over one step.",
    "dispersion": "The ridge is the energy along the dispersion relation. Without a fitted current, this"
    " group contains only the theory.",
    "fusion": "Noise of stereo z and of integrated w, and their best combination.",
    "direction": "Directions of the waves on the dispersion relation; NaN where these waves are below the"
    " noise. The package wavespectra reads this group:"
    " `xarray.open_dataset(store, engine='zarr', group='direction').spec`.",
    "higher_order": "Missing if the record has fewer than four segments.",
}
