"""The variables of a wave store, group by group, and of what the estimators give in a notebook."""

from typing import Any

from wavefield.variables.table import Variable, register
from wavefield.variables.units import product

K_UNITS, OMEGA_UNITS = "rad m-1", "rad s-1"

# spectral names: units and words
FIELD_UNITS = {"z": "m"} | dict.fromkeys(("z_t", "u", "v", "w", "nl"), "m s-1")
FIELD_TEXTS = {
    "z": "surface elevation at frame times",
    "z_t": "rate of rise of the surface",
    "u": "velocity along x",
    "v": "velocity along y",
    "w": "vertical velocity",
    "nl": "nonlinear term u . grad z",
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

    Parameters
    ----------
    unit : str
        Unit of the field.
    *over : str
        Axes that it is a density over: k (once for each direction) or omega.

    Returns
    -------
    str

    Examples
    --------
    >>> density_units("m", "k", "omega")
    'm3 s rad-2'
    """
    axes = {"k": K_UNITS, "omega": OMEGA_UNITS}
    return product((unit, 2), *((axes[name], -1) for name in over))


def _rows(group: str, dims: tuple[str, ...], *rows: tuple[Any, ...], **more: Any) -> None:
    # (name, units, long_name[, meaning])
    for name, units, text, *meaning in rows:
        note = meaning[0] if meaning else ""
        register(Variable(name, dims, units, text, meaning=note, group=group, **{"dtype": "float64"} | more))


_TRUST = "where the spectrum can be trusted"
_LOW, _HIGH = "lower end of the 95 % interval, factor", "upper end of the 95 % interval, factor"

# ---- axes ----
_rows("", ("omega",), ("omega", OMEGA_UNITS, "angular frequency"), ("frequency", "Hz", "frequency"))
_rows("", ("k",), ("k", K_UNITS, "wavenumber"), ("cycles", "m-1", "wavenumber / 2 pi"))
_rows("", ("kx",), ("kx", K_UNITS, "wavenumber along x"))
_rows("", ("ky",), ("ky", K_UNITS, "wavenumber along y"))
_rows("", ("omega_map",), ("omega_map", OMEGA_UNITS, "angular frequency of the map"))
_rows("", ("omega1",), ("omega1", OMEGA_UNITS, "angular frequency"))
_rows("", ("omega2",), ("omega2", OMEGA_UNITS, "angular frequency"))
_rows("", ("theta",), ("theta", "rad", "direction of propagation, from x towards y"))
_rows("", ("step",), ("step", "1", "step of the cube"), dtype="int64")
_rows("", ("band",), ("band_frequency", "Hz", "middle of the band"))
_rows("", ("bin",), ("bin", "1", "(value - mean) / standard deviation"))
_rows("", ("eps_bin",), ("eps_bin", "1", "(value - mean) / standard deviation"))
_rows("", ("quantity",), ("quantity", "", "elevation, and displacement over one time step"), dtype="str")
_rows("", ("source",), ("source", "", "method that gives the elevation"), dtype="str")

# ---- a spectrum of any field ----
for _shape, _dims, _text in (
    ("plane", ("omega", "ky", "kx"), "power spectrum"),
    ("komega", ("omega", "k"), "E(k, omega)"),
    ("k", ("k",), "E(k)"),
    ("frequency", ("omega",), "E(omega)"),
):
    _rows(_shape, _dims, ("E", "", _text))
_rows("maps", ("omega_map", "ky", "kx"), ("E", "", "E(ky, kx)"))
_rows(
    "",
    ("omega", "k"),
    ("dof", "1", "degrees of freedom"),
    ("low", "1", _LOW),
    ("high", "1", _HIGH),
)
_rows("", ("omega",), ("dof_omega", "1", "degrees of freedom of E(omega)"))
_rows("", ("k",), ("dof_k", "1", "degrees of freedom of E(k)"))
_rows("", ("omega", "k"), ("valid", "1", _TRUST), dtype="bool")
_rows(
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
        _rows(
            "spectra",
            _dims,
            (f"{_head}_{_f}", density_units(_unit, *_over), f"{_text} of {FIELD_TEXTS[_f]}"),
            family=f"{_head}_*",
        )
        for _q, _qt in (("dof", "degrees of freedom"), ("low", _LOW), ("high", _HIGH)):
            _rows("spectra", _dims, (f"{_q}_{_name}_{_f}", "1", _qt), family=f"{_q}_{_name}_*")
_rows("spectra", ("omega", "k"), ("valid_komega", "1", _TRUST), dtype="bool")
for _m, _text in METHODS.items():
    _rows("spectra", ("omega",), (f"Ez_{_m}", ELEVATION_UNITS, _text), family="Ez_*")
    for _q, _qt in (("dof", "degrees of freedom"), ("low", _LOW), ("high", _HIGH)):
        _rows("spectra", ("omega",), (f"{_q}_{_m}", "1", _qt), family=f"{_q}_*")
    _flag = _TRUST if _m == "probes" else "right within a factor 2"
    _rows("spectra", ("omega",), (f"valid_{_m}", "1", _flag), dtype="bool", family="valid_*")
_rows("spectra", ("probe", "omega"), ("Ez_probe", ELEVATION_UNITS, "elevation spectrum of each probe"))
for _g in ("two_frames", "four_frames", "displacement"):
    _rows("spectra", ("omega",), (f"gain_{_g}", "1", f"power gain: {_g.replace('_', ' ')}"), family="gain_*")
for _f in ("z", "w"):
    _rows(
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
    _rows(
        "cross",
        ("omega", "k"),
        (f"E_{_a}", density_units(FIELD_UNITS[_a], "k", "omega"), f"E(k, omega) of {FIELD_TEXTS[_a]}"),
        (f"dof_{_a}", "1", "degrees of freedom"),
    )
    for _axis in ("omega", "k"):
        _rows("cross", (_axis,), (f"dof_{_axis}_{_a}", "1", f"degrees of freedom of E({_axis})"))
    for _b in FIELD_UNITS:
        _rows(
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
_rows("cross", ("omega", "k"), ("valid", "1", _TRUST), dtype="bool")

# ---- /coherence ----
for _ending, _dims in (("", ("k",)), ("_komega", ("omega", "k"))):
    for _t, _text in (("w", "w"), ("nl", "-u . grad z"), ("tot", "w - u . grad z")):
        _rows(
            "coherence",
            _dims,
            (
                f"C_{_t}{_ending}",
                "1",
                f"coherence of z_t with {_text}, common normalisation",
                "complex; its real part is the mean over both signs of omega; C_w + C_nl = C_tot,"
                " so that the modulus of C_w may exceed 1",
            ),
            dtype="complex128",
            family=f"C_*{_ending}",
        )
        _rows(
            "coherence",
            _dims,
            (f"gamma2_{_t}{_ending}", "1", f"coherence of z_t with {_text}, magnitude squared"),
            family=f"gamma2_*{_ending}",
        )
        for _q, _qt, _note in (
            ("samples", "effective independent samples", "from the degrees of freedom of both spectra"),
            ("bias", "mean gamma2 of unrelated signals", ""),
            ("level", "gamma2 that unrelated signals exceed in 5 % of cases", ""),
        ):
            _rows("coherence", _dims, (f"{_q}_{_t}{_ending}", "1", _qt, _note), family=f"{_q}_*{_ending}")

# ---- /kinematics ----
_rows(
    "kinematics",
    ("step",),
    ("w_rms", "m s-1", "vertical velocity, rms", "over the rectangle, at the sampled steps"),
    ("z_t_rms", "m s-1", "rate of rise, rms"),
    ("nonlinear_rms", "m s-1", "nonlinear term u . grad z, rms"),
    ("residual_rms", "m s-1", "residual z_t - w + u . grad z, rms"),
    ("finite_residual_rms", "m s-1", "residual for finite displacements, rms"),
    ("vorticity_rms", "s-1", "vorticity, rms"),
    ("divergence_rms", "s-1", "divergence, rms"),
    ("time", "s", "time"),
)
_rows(
    "kinematics",
    (),
    ("nonlinear_fraction", "1", "nonlinear term over w, rms"),
    ("residual_fraction", "1", "residual over nonlinear term, rms"),
    ("finite_residual_fraction", "1", "residual for finite displacements over nonlinear term, rms"),
)
_rows(
    "",
    ("time", "y", "x"),
    ("z_x", "1", "slope along x"),
    ("z_y", "1", "slope along y"),
    ("nonlinear", "m s-1", "nonlinear term u . grad z"),
    ("residual", "m s-1", "kinematic residual z_t - w + u . grad z"),
    ("vorticity", "s-1", "vertical vorticity v_x - u_y of the surface"),
    ("divergence", "s-1", "divergence u_x + v_y of the surface"),
    ("finite_residual", "m s-1", "kinematic residual, finite displacements"),
    dtype="float32",
)

# ---- /statistics ----
_rows(
    "statistics",
    ("quantity", "bin"),
    ("pdf", "1", "probability density, standard deviation = 1"),
)
_rows("statistics", ("bin",), ("gaussian", "1", "Gaussian"))
_rows(
    "statistics",
    ("quantity",),
    ("mean", "m", "mean"),
    (
        "std",
        "m",
        "standard deviation",
        "in time: what stands still is taken off, and of skewness and kurtosis",
    ),
    ("static_std", "m", "standard deviation over the nodes of the mean over time"),
    ("wild", "1", "values beyond six standard deviations"),
    ("std_px", "pixel", "standard deviation", "where the cube says how large a pixel is"),
    ("skewness", "1", "skewness"),
    ("kurtosis", "1", "excess kurtosis"),
    ("count", "1", "number of values"),
)
_rows(
    "statistics",
    (),
    ("significant_height", "m", "significant wave height, 4 sigma"),
    ("mean_square_slope", "1", "mean square slope"),
    ("slope_rms", "1", "rms slope"),
    ("peak_frequency", "Hz", "frequency of the spectral peak"),
    ("peak_k", K_UNITS, "wavenumber of the spectral peak"),
    ("steepness", "1", "steepness k_p sigma"),
)
for _e, _unit in (("eps_y", "m"), ("eps_piv", "pixel")):
    for _q in ("mean", "std", "rms"):
        _rows("statistics", (), (f"{_e}_{_q}", _unit, f"{_q} of {_e}"), family=f"{_e}_*")
_rows(
    "statistics",
    ("error", "eps_bin"),
    ("eps_pdf", "1", "probability density of the errors, standard deviation = 1"),
)

# ---- /dispersion ----
_rows(
    "dispersion",
    ("k",),
    ("omega_theory", OMEGA_UNITS, "dispersion relation, clean water, no current"),
    ("omega_fit", OMEGA_UNITS, "dispersion relation with the fitted surface tension, no current"),
)
_rows(
    "dispersion",
    ("point",),
    ("ridge_omega", OMEGA_UNITS, "angular frequency of the ridge"),
    ("ridge_k", K_UNITS, "wavenumber of the ridge"),
    ("ridge_angle", "rad", "direction of propagation, from x towards y"),
    ("ridge_weight", "", "energy on the ridge"),
)
_rows(
    "dispersion",
    (),
    ("current_x", "m s-1", "current along x"),
    ("current_x_std", "m s-1", "standard uncertainty of the current along x"),
    ("current_y", "m s-1", "current along y"),
    ("current_y_std", "m s-1", "standard uncertainty of the current along y"),
    ("gamma", "m3 s-2", "surface tension over density"),
    ("gamma_std", "m3 s-2", "standard uncertainty of the surface tension over density"),
    ("ridge_fraction", "1", "fraction of the variance within the ridge"),
    ("depth", "m", "depth of the water"),
)
_rows(
    "dispersion",
    ("band",),
    (
        "ridge_error",
        "1",
        "ridge's wavenumber against the theory's, relative",
        "theory with the fitted current and the surface tension of the water",
    ),
)

# ---- /fusion ----
_rows(
    "fusion",
    ("omega",),
    ("noise_z", ELEVATION_UNITS, "noise of the stereo elevation"),
    ("noise_w", ELEVATION_UNITS, "noise of the integrated w"),
    ("noise_z_fit", ELEVATION_UNITS, "noise of the stereo elevation, white fit"),
    ("noise_w_fit", ELEVATION_UNITS, "noise of the integrated w, fit of white displacement noise"),
    ("weight_z", "1", "weight of stereo in the best combination"),
    ("wiener", "1", "Wiener gain S / (S + N), for time series"),
)
_rows(
    "fusion",
    (),
    ("sigma_z", "m", "noise of z, rms", "without a record at rest"),
    ("sigma_dz", "m", "noise of the displacement dz, rms", "without a record at rest"),
    (
        "noise_coherence",
        "1",
        "correlation of the noises of z and integrated w",
        "off the ridge, above it in k; NaN where the spectrum has no such place",
    ),
)
_rows(
    "fusion",
    ("omega", "k"),
    (
        "Ez_komega",
        density_units("m", "k", "omega"),
        "E(k, omega) of the elevation, best combination, windows undone, noise taken off",
        "with a gain alone; NaN where it cannot be trusted",
    ),
)
_rows(
    "fusion",
    ("source",),
    ("range_frequency", "Hz", "right within a factor 2 up to"),
    ("range_decades", "1", "decades below the peak up to there"),
)

# ---- /direction ----
_rows(
    "direction",
    ("omega_map", "theta"),
    ("D", "rad-1", "directional density on the ridge", "its integral over theta is 1"),
    ("dof_D", "1", "degrees of freedom"),
    ("low_D", "1", _LOW),
    ("high_D", "1", _HIGH),
)
_rows(
    "direction",
    ("omega_map",),
    ("direction", "rad", "mean direction of propagation, from x towards y"),
    ("spread", "rad", "directional spread", "the resolution is taken off"),
)
_rows(
    "",
    ("frequency",),
    ("energy", "", "spectrum of the waves on the ridge, per Hz"),
    ("r1", "1", "modulus of the first harmonic of the directional density"),
    ("r2", "1", "modulus of the second harmonic of the directional density"),
)
_rows("direction", ("omega",), ("isotropy", "1", "isotropy, 1 - largest of the first two harmonics"))

# ---- /higher_order ----
_rows(
    "higher_order",
    ("omega1", "omega2"),
    ("bicoherence", "1", "bicoherence"),
    ("bicoherence_level", "1", "what surrogates exceed in 5 % of cases"),
    ("tricoherence", "1", "tricoherence at the best omega3", "trivial pairings left out"),
    ("tricoherence_level", "1", "what surrogates exceed in 5 % of cases"),
    ("tricoherence_omega3", OMEGA_UNITS, "omega3 of the largest tricoherence"),
)
_rows("higher_order", (), ("bicoherence_samples", "1", "segments times points"))

# ---- probes and gains ----
_rows("probes", ("probe", "time"), ("elevation", "m", "surface elevation"))
_rows("probes", ("time",), ("time", "s", "time"))
_rows(
    "",
    ("probe",),
    ("probe_x", "m", "place of the probe along x"),
    ("probe_y", "m", "place of the probe along y"),
)
_rows("gain", ("direction",), ("direction", "rad", "direction of the wave vector, either way"))
for _f, _text in (
    ("z", "elevation"),
    ("u", "displacement dx"),
    ("v", "displacement dy"),
    ("w", "displacement dz"),
):
    _rows("gain", ("direction", "k"), (f"gain_{_f}", "1", f"amplitude gain of the {_text}"))
    _rows("gain", ("k",), (f"coherence_{_f}", "1", f"squared coherence of the {_text} with the truth"))

# groups of the wave store, in order, with what the documentation says of each as a whole
GROUPS = {
    "spectra": "z is at frame times; nl is u . grad z. `E_komega_*` is the integral over the angle of k; the"
    " azimuthal mean is E / (2 pi k coverage). `Ez_*` is the spectrum of the elevation by each method,"
    " transfer functions in time undone (with a gain the matching windows as well).",
    "coherence": "Of z_t with w, with -u . grad z and with their sum.",
    "kinematics": "The balance z_t = w - u . grad z at sampled steps.",
    "statistics": "Distributions and moments; displacements dx, dy, dz are those over one time step.",
    "dispersion": "The theory alone where no ridge could be followed.",
    "fusion": "Noise of stereo and of the integrated w, and their best combination.",
    "direction": "On the ridge. `isotropy` has its own omega.",
    "higher_order": "Missing where the record holds fewer than four segments.",
}
