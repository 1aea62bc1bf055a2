"""The variables of a wave store: of its spectra by rule, the others from their text table."""

import re
from pathlib import Path
from typing import Any

from wavefield.variables.table import Variable, product, register

K_UNITS, OMEGA_UNITS = "rad m-1", "rad s-1"

# spectral names: units and words
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
METHODS = {
    "stereo": "elevation spectrum from stereo",
    "w": "elevation spectrum from integrated w",
    "cross": "elevation spectrum from the cross spectrum of stereo and integrated w",
    "fusion": "elevation spectrum from the best combination, noise taken off",
    "probes": "elevation spectrum from probes",
}
ELEVATION_UNITS = "m2 s rad-1"


def density_units(unit: str, *over: str) -> str:
    """Units of a power spectrum.

    Examples
    --------
    >>> density_units("m", "k", "omega")
    'm3 s rad-2'
    """
    axes = {"k": K_UNITS, "omega": OMEGA_UNITS}
    return product((unit, 2), *((axes[name], -1) for name in over))


def rows(group: str, dims: tuple[str, ...], *rows: tuple[Any, ...], **more: Any) -> None:
    """Register variables of one group and shape, each (name, units, long_name[, meaning])."""
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
rows("", ("quantity",), ("quantity", "", "elevation, and displacement over one time step"), dtype="str")
rows("", ("source",), ("source", "", "method that gives the elevation"), dtype="str")

# ---- a spectrum of any field ----
for _shape, _dims, _text in (
    ("plane", ("omega", "ky", "kx"), "power spectrum"),
    ("komega", ("omega", "k"), "E(k, omega)"),
    ("k", ("k",), "E(k)"),
    ("frequency", ("omega",), "E(omega)"),
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

# ---- /spectra ----
for _f, _unit in FIELD_UNITS.items():
    for _name, _dims, _over, _text in (
        ("komega", ("omega", "k"), ("k", "omega"), "E(k, omega)"),
        ("E_k", ("k",), ("k",), "E(k)"),
        ("E", ("omega",), ("omega",), "E(omega)"),
    ):
        _head = "E_komega" if _name == "komega" else _name
        rows(
            "spectra",
            _dims,
            (f"{_head}_{_f}", density_units(_unit, *_over), f"{_text} of {FIELD_TEXTS[_f]}"),
            family=f"{_head}_*",
        )
        for _q, _qt in (("dof", "degrees of freedom"), ("low", LOW), ("high", HIGH)):
            rows("spectra", _dims, (f"{_q}_{_name}_{_f}", "1", _qt), family=f"{_q}_{_name}_*")
    if _f not in ("rise", "nl"):
        _half = "where the measurement keeps half of a wave or more"
        _more = "the spectra are corrected there; only with a gain"
        rows("spectra", ("k",), (f"valid_k_{_f}", "1", _half, _more), dtype="bool", family="valid_k_*")
rows("spectra", ("omega", "k"), ("valid_komega", "1", _TRUST), dtype="bool")
for _m, _text in METHODS.items():
    rows("spectra", ("omega",), (f"Ez_{_m}", ELEVATION_UNITS, _text), family="Ez_*")
    for _q, _qt in (("dof", "degrees of freedom"), ("low", LOW), ("high", HIGH)):
        rows("spectra", ("omega",), (f"{_q}_{_m}", "1", _qt), family=f"{_q}_*")
    _flag = _TRUST if _m == "probes" else "right within a factor 2"
    rows("spectra", ("omega",), (f"valid_{_m}", "1", _flag), dtype="bool", family="valid_*")
rows("spectra", ("probe", "omega"), ("Ez_probe", ELEVATION_UNITS, "elevation spectrum of each probe"))
for _f in ("z", "w"):
    rows(
        "spectra",
        ("omega_map", "ky", "kx"),
        (
            f"E_kxky_{_f}",
            density_units(FIELD_UNITS[_f], "k", "k", "omega"),
            f"E(ky, kx) of {FIELD_TEXTS[_f]}",
            "at chosen frequencies, the paper's 2.8 Hz among them",
        ),
        family="E_kxky_*",
    )

# ---- cross spectra in a notebook ----
for _a in FIELD_UNITS:
    rows(
        "cross",
        ("omega", "k"),
        (f"E_{_a}", density_units(FIELD_UNITS[_a], "k", "omega"), f"E(k, omega) of {FIELD_TEXTS[_a]}"),
        (f"dof_{_a}", "1", "degrees of freedom"),
    )
    for _axis in ("omega", "k"):
        rows("cross", (_axis,), (f"dof_{_axis}_{_a}", "1", f"degrees of freedom of E({_axis})"))
    for _b in FIELD_UNITS:
        rows(
            "cross",
            ("omega", "k"),
            (
                f"S_{_a}_{_b}",
                product((FIELD_UNITS[_a], 1), (FIELD_UNITS[_b], 1), (K_UNITS, -1), (OMEGA_UNITS, -1)),
                f"cross spectrum of {FIELD_TEXTS[_a]} with {FIELD_TEXTS[_b]}",
                "conj of the first times the second, for waves exp(i (k . x - omega t))",
            ),
            dtype="complex128",
        )
        _count = "independent samples of the cross spectrum"
        rows("cross", ("omega", "k"), (f"samples_{_a}_{_b}", "1", _count))
        rows("cross", ("k",), (f"samples_k_{_a}_{_b}", "1", f"{_count}, summed over omega"))
rows("cross", ("omega", "k"), ("valid", "1", _TRUST), dtype="bool")

# ---- /coherence ----
rows("coherence", ("k",), ("valid", "1", "where the waves exceed the noise"), dtype="bool")
for _ending, _dims in (("", ("k",)), ("_komega", ("omega", "k"))):
    for _t, _text in (("w", "w"), ("nl", "-u . grad z"), ("tot", "w - u . grad z")):
        rows(
            "coherence",
            _dims,
            (
                f"C_{_t}{_ending}",
                "1",
                f"coherence of z_t with {_text}, common normalisation",
                "complex; real part: mean over both signs of omega; C_w + C_nl = C_tot, so that the modulus"
                " of C_w may exceed 1",
            ),
            dtype="complex128",
            family="C_*",
        )
        rows(
            "coherence",
            _dims,
            (f"gamma2_{_t}{_ending}", "1", f"coherence of z_t with {_text}, magnitude squared"),
            family="gamma2_*",
        )
        for _q, _qt, _note in (
            (
                "samples",
                "effective independent samples",
                "fewer where both have their energy in the same cells",
            ),
            ("bias", "mean gamma2 of unrelated signals", ""),
            ("level", "gamma2 that unrelated signals exceed in 5 % of cases", ""),
        ):
            rows("coherence", _dims, (f"{_q}_{_t}{_ending}", "1", _qt, _note), family=f"{_q}_*")


_SECTION = re.compile(r"/(\w*) \(([\w, ]*)\) ?(\w*)")


def _rows(text: str) -> list[Variable]:
    """Read variables from the text of `wave_variables.txt`, whose first lines describe its format."""
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
    "spectra": "z is at frame times; nl is u . grad z. `E_komega_*` is integrated over the angle of k; the"
    " azimuthal mean is E / (2 pi k coverage). `Ez_*` is the elevation spectrum by each method, corrected for"
    " the response in time (with a gain also for the matching windows).",
    "coherence": "Of z_t with w, with -u . grad z and with their sum. `gamma2_*` is the squared coherence;"
    " `bias_*` and `level_*` are its mean and its 5 % level for unrelated signals.",
    "kinematics": "The balance z_t = w - u . grad z at sampled steps.",
    "statistics": "Distributions and moments of z and of the displacements over one step.",
    "dispersion": "Only the theory where the dispersion relation could not be fitted.",
    "fusion": "Noise of stereo and of the integrated w, and their best combination.",
    "direction": "On the ridge. `isotropy` has its own omega.",
    "directional": "E(f, theta) of the elevation for wavespectra:"
    " `xarray.open_dataset(store, engine='zarr', group='directional').spec`. Missing where the dispersion"
    " relation could not be fitted.",
    "higher_order": "Missing where the record holds fewer than four segments.",
}
