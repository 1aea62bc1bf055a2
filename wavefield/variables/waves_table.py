"""The variables of a wave store beyond its spectra."""

from wavefield.variables.spectra_table import (
    ELEVATION_UNITS,
    HIGH,
    K_UNITS,
    LOW,
    OMEGA_UNITS,
    density_units,
    rows,
)

# ---- /kinematics ----
rows(
    "kinematics",
    ("step",),
    ("w_rms", "m s-1", "vertical velocity, rms", "over the rectangle, at the sampled steps"),
    ("z_t_rms", "m s-1", "rate of rise, rms"),
    ("nonlinear_rms", "m s-1", "nonlinear term (u - U) . grad z, rms", "U is the mean current"),
    ("residual_rms", "m s-1", "residual z_t - w + u . grad z, rms"),
    ("finite_residual_rms", "m s-1", "residual for finite displacements, rms"),
    ("vorticity_rms", "s-1", "vorticity, rms"),
    ("divergence_rms", "s-1", "divergence, rms"),
    ("time", "s", "time"),
)
rows(
    "kinematics",
    (),
    ("nonlinear_fraction", "1", "nonlinear term over w, rms"),
    ("residual_fraction", "1", "residual over nonlinear term, rms"),
    ("finite_residual_fraction", "1", "residual for finite displacements over nonlinear term, rms"),
    ("mean_current_x", "m s-1", "mean of u, which nonlinear quantities are relative to"),
    ("mean_current_x_std", "m s-1", "standard uncertainty of the mean of u"),
    ("mean_current_y", "m s-1", "mean of v, which nonlinear quantities are relative to"),
    ("mean_current_y_std", "m s-1", "standard uncertainty of the mean of v"),
)
for _axis in ("k", "omega"):
    rows(
        "kinematics",
        (_axis,),
        (f"nonlinear_ratio_{_axis}", "1", "amplitude of (u - U) . grad z over that of w"),
        (f"low_nonlinear_ratio_{_axis}", "1", LOW),
        (f"high_nonlinear_ratio_{_axis}", "1", HIGH),
    )
rows(
    "",
    ("time", "y", "x"),
    ("z_x", "1", "slope along x"),
    ("z_y", "1", "slope along y"),
    ("nonlinear", "m s-1", "nonlinear term (u - U) . grad z"),
    ("residual", "m s-1", "kinematic residual z_t - w + u . grad z"),
    ("vorticity", "s-1", "vertical vorticity v_x - u_y of the surface"),
    ("divergence", "s-1", "divergence u_x + v_y of the surface"),
    ("finite_residual", "m s-1", "kinematic residual, finite displacements"),
    dtype="float32",
)

# ---- /statistics ----
rows(
    "statistics",
    ("quantity", "bin"),
    ("pdf", "1", "probability density, standard deviation = 1"),
)
rows("statistics", ("bin",), ("gaussian", "1", "Gaussian"))
rows(
    "statistics",
    ("quantity",),
    ("mean", "m", "mean"),
    (
        "std",
        "m",
        "standard deviation",
        "in time: what stands still is taken off, and of skewness and kurtosis",
    ),
    ("pdf_std", "m", "standard deviation that the densities are scaled by, what stands still included"),
    ("static_std", "m", "standard deviation over the nodes of the mean over time"),
    ("wild", "1", "values beyond six standard deviations"),
    ("std_px", "pixel", "standard deviation", "where the cube says how large a pixel is"),
    ("skewness", "1", "skewness"),
    ("kurtosis", "1", "excess kurtosis"),
    ("count", "1", "number of values"),
)
rows(
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
        rows("statistics", (), (f"{_e}_{_q}", _unit, f"{_q} of {_e}"), family=f"{_e}_*")
rows(
    "statistics",
    ("error", "eps_bin"),
    ("eps_pdf", "1", "probability density of the errors, standard deviation = 1"),
)

# ---- /dispersion ----
rows(
    "dispersion",
    ("k",),
    ("omega_theory", OMEGA_UNITS, "dispersion relation without current"),
    ("omega_fit", OMEGA_UNITS, "dispersion relation with the fitted surface tension, no current"),
)
rows(
    "dispersion",
    ("point",),
    ("ridge_omega", OMEGA_UNITS, "angular frequency of the ridge"),
    ("ridge_k", K_UNITS, "wavenumber of the ridge"),
    ("ridge_angle", "rad", "direction of propagation, from x towards y"),
    ("ridge_weight", "", "energy on the ridge"),
)
rows(
    "dispersion",
    ("line",),
    ("line_signal_to_noise", "1", "energy of the ridge over that of the noise in its window"),
    ("line_weight", "1", "share of what determines the current"),
    ("line_misfit", "1", "mean misfit of the ridge over its standard deviation"),
)
rows(
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
rows(
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
rows(
    "fusion",
    ("omega",),
    ("noise_z", ELEVATION_UNITS, "noise of the stereo elevation"),
    ("noise_w", ELEVATION_UNITS, "noise of the integrated w"),
    ("noise_z_fit", ELEVATION_UNITS, "noise of the stereo elevation, white fit"),
    ("noise_w_fit", ELEVATION_UNITS, "noise of the integrated w, fit of white displacement noise"),
    ("weight_z", "1", "weight of stereo in the best combination"),
    ("wiener", "1", "Wiener gain S / (S + N), for time series"),
)
rows(
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
rows(
    "fusion",
    ("omega", "k"),
    (
        "Ez_komega",
        density_units("m", "k", "omega"),
        "E(k, omega) of the elevation, best combination, windows undone, noise taken off",
        "with a gain alone; NaN where it cannot be trusted",
    ),
)
rows(
    "fusion",
    ("source",),
    ("range_frequency", "Hz", "right within a factor 2 up to"),
    ("range_decades", "1", "decades below the peak up to there"),
)

# ---- /direction ----
rows(
    "direction",
    ("omega_map", "theta"),
    ("D", "rad-1", "directional density on the ridge", "its integral over theta is 1"),
    ("dof_D", "1", "degrees of freedom"),
    ("low_D", "1", LOW),
    ("high_D", "1", HIGH),
)
rows(
    "direction",
    ("omega_map",),
    ("direction", "rad", "mean direction of propagation, from x towards y"),
    ("spread", "rad", "directional spread", "the resolution is taken off"),
)
rows(
    "",
    ("frequency",),
    ("energy", "", "spectrum of the waves on the ridge, per Hz"),
    ("r1", "1", "modulus of the first harmonic of the directional density"),
    ("r2", "1", "modulus of the second harmonic of the directional density"),
)
rows("direction", ("omega",), ("isotropy", "1", "isotropy, 1 - largest of the first two harmonics"))

# ---- /higher_order ----
rows(
    "higher_order",
    ("omega1", "omega2"),
    ("bicoherence", "1", "bicoherence"),
    ("bicoherence_level", "1", "what surrogates exceed in 5 % of cases"),
    ("tricoherence", "1", "tricoherence at the best omega3", "trivial pairings left out"),
    ("tricoherence_level", "1", "what surrogates exceed in 5 % of cases"),
    ("tricoherence_omega3", OMEGA_UNITS, "omega3 of the largest tricoherence"),
)
rows("higher_order", (), ("bicoherence_samples", "1", "segments times points"))

# ---- /directional, in the oceanographers' words ----
rows("directional", ("freq", "dir"), ("efth", "m2 s degree-1", "directional spectrum of the elevation"))
rows("directional", ("freq", "dir"), ("dof", "1", "degrees of freedom"))
rows("directional", ("freq",), ("freq", "Hz", "frequency", "as the water sees it"))
rows(
    "directional",
    ("dir",),
    ("dir", "degree", "direction where waves come from", "clockwise from the y axis"),
)
rows(
    "directional",
    ("freq",),
    ("mean_direction", "degree", "mean direction where waves come from"),
    ("directional_spread", "degree", "directional spread", "the resolution is taken off"),
    ("r1", "1", "modulus of the first harmonic of the directional density"),
    ("r2", "1", "modulus of the second harmonic of the directional density"),
)

# ---- /shear ----
rows(
    "shear",
    ("k_band",),
    ("k_band", K_UNITS, "wavenumber of the band"),
    ("effective_depth", "m", "depth 1 / 2k that the band stands for"),
    ("doppler_x", "m s-1", "current along x that waves of the band feel"),
    ("doppler_x_std", "m s-1", "its standard uncertainty"),
    ("doppler_y", "m s-1", "current along y that waves of the band feel"),
    ("doppler_y_std", "m s-1", "its standard uncertainty"),
)
rows(
    "shear",
    ("z",),
    ("z", "m", "height above the mean level"),
    ("current_x", "m s-1", "current along x"),
    ("current_x_std", "m s-1", "standard uncertainty of the current along x"),
    ("current_y", "m s-1", "current along y"),
    ("current_y_std", "m s-1", "standard uncertainty of the current along y"),
)

# ---- /bound ----
rows(
    "bound",
    ("omega",),
    ("E_free", "m2 s rad-1", "spectrum of the free waves"),
    ("E_bound", "m2 s rad-1", "spectrum of the bound waves"),
    ("E_harmonic", "m2 s rad-1", "spectrum on the ridge of the second harmonic"),
)
rows(
    "bound",
    (),
    ("bound_fraction", "1", "fraction of the variance of the elevation in bound waves"),
    ("bound_fraction_std", "1", "its standard uncertainty"),
    ("harmonic_fraction", "1", "fraction on the ridge of the second harmonic"),
    ("sum_fraction", "1", "fraction in waves longer than free ones, without the second harmonic"),
    ("difference_fraction", "1", "fraction in waves shorter than free ones"),
    ("noise_fraction", "1", "fraction in noise, which is taken off"),
    ("ridge_reach", K_UNITS, "half the width given to the ridge"),
    ("ridge_width", K_UNITS, "width of the ridge beyond that of the windows, rms"),
)
rows(
    "",
    ("time", "y", "x"),
    ("z_free", "m", "elevation of the free waves"),
    ("z_bound", "m", "elevation of the bound waves"),
    dtype="float32",
)

# ---- /resonances ----
for _kind, _words in (("quartet", "k1 + k2 = k3 + k4"), ("triad", "k1 + k2 = k3")):
    rows(
        "resonances",
        (_kind, f"{_kind}_wave"),
        (f"{_kind}_kx", K_UNITS, f"wave vectors along x, {_words}"),
        (f"{_kind}_ky", K_UNITS, f"wave vectors along y, {_words}"),
        (f"{_kind}_omega", OMEGA_UNITS, "angular frequencies"),
    )
    rows(
        "resonances",
        (_kind,),
        (f"{_kind}_coherence", "1", "squared coherence"),
        (f"{_kind}_coherence_std", "1", "its standard uncertainty"),
        (f"{_kind}_probability", "1", "probability that chance gives as much"),
        (f"{_kind}_significant", "1", "whether it is significant among all that were tested"),
        (f"{_kind}_mismatch", OMEGA_UNITS, "how far the last wave lies off the dispersion relation"),
    )
    rows("resonances", (), (f"{_kind}_tests", "1", f"number of {_kind}s tested"))
rows("resonances", ("mismatch",), ("mismatch", OMEGA_UNITS, "frequency off resonance"))
rows(
    "resonances",
    ("mismatch",),
    ("coherence_excess", "1", "mean squared coherence of quartets less that of surrogates"),
    ("coherence_excess_std", "1", "its standard uncertainty"),
    ("quartets", "1", "number of quartets"),
)
rows(
    "resonances",
    (),
    ("modes", "1", "number of wave vectors"),
    ("samples", "1", "number of segments"),
)

# ---- coherence of each wave vector, in a notebook and on the paper's page ----
for _term, _words in (("w", "w"), ("nl", "-u . grad z"), ("tot", "w - u . grad z")):
    rows("", ("ky", "kx"), (f"plane_C_{_term}", "1", f"coherence of z_t with {_words}, modulus"))
    rows("", ("k",), (f"mean_C_{_term}", "1", f"coherence of z_t with {_words}, averaged after the ratio"))

# ---- probes and gains ----
rows("probes", ("probe", "time"), ("elevation", "m", "surface elevation"))
rows("probes", ("time",), ("time", "s", "time"))
rows(
    "",
    ("probe",),
    ("probe_x", "m", "place of the probe along x"),
    ("probe_y", "m", "place of the probe along y"),
)
rows("gain", ("direction",), ("direction", "rad", "direction of the wave vector, either way"))
for _f, _text in (
    ("z", "elevation"),
    ("u", "displacement dx"),
    ("v", "displacement dy"),
    ("w", "displacement dz"),
):
    rows("gain", ("direction", "k"), (f"gain_{_f}", "1", f"amplitude gain of the {_text}"))
    rows("gain", ("k",), (f"coherence_{_f}", "1", f"squared coherence of the {_text} with the truth"))

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
    "directional": "E(f, theta) of the elevation as wavespectra takes it:"
    " `xarray.open_dataset(store, engine='zarr', group='directional').spec`. Like `shear` it is missing where"
    " no ridge could be followed.",
    "bound": "Free waves, and waves bound to others, which lie beside the ridge. Missing without a ridge.",
    "resonances": "Triads and quartets of wave vectors, the least probable first. Missing without a ridge, or"
    " with fewer than 8 segments of 64 steps.",
    "shear": "Current by depth from the Doppler shift of each band of wavenumbers, and u, v at the surface.",
    "higher_order": "Missing where the record holds fewer than four segments.",
}
