"""The variables of what the estimators of waves give in a notebook."""

from wavefield.variables.spectra_table import HIGH, LOW, rows

# ---- crests, troughs and errors of moments ----
rows(
    "crests",
    (),
    ("significant_height", "m", "significant wave height, 4 sigma"),
    ("significant_height_std", "m", "its standard uncertainty"),
    ("skewness", "1", "skewness of the elevation"),
    ("skewness_std", "1", "its standard uncertainty"),
    ("kurtosis", "1", "excess kurtosis of the elevation"),
    ("kurtosis_std", "1", "its standard uncertainty"),
    ("mean_period", "s", "mean time between zero up-crossings"),
    ("waves", "1", "number of waves"),
)
rows(
    "crests",
    ("level",),
    ("level", "1", "level over the standard deviation of the elevation"),
    ("crest_exceedance", "1", "fraction of crests above the level"),
    ("crest_exceedance_std", "1", "its standard uncertainty"),
    ("trough_exceedance", "1", "fraction of troughs below the level, turned"),
    ("trough_exceedance_std", "1", "its standard uncertainty"),
    ("rayleigh", "1", "Rayleigh's fraction"),
    ("tayfun", "1", "Tayfun's fraction, of second-order crests"),
)

# ---- crests about to break ----
rows(
    "breaking",
    ("time", "y", "x"),
    ("B", "1", "speed of the water over that of the crest", "at crests; they break above about .85"),
    ("crest_speed", "m s-1", "speed of the crest"),
    dtype="float32",
)
rows(
    "breaking",
    ("event",),
    ("event_time", "s", "time of the largest B"),
    ("event_x", "m", "place of the largest B along x"),
    ("event_y", "m", "place of the largest B along y"),
    ("event_B", "1", "largest B of the event"),
    ("event_duration", "s", "time above the onset"),
    ("event_length", "m", "length of the crest above the onset"),
)
rows("breaking", ("event", "time"), ("history", "1", "largest B at each step"), dtype="float32")

# ---- intermittency ----
for _axis, _unit, _words in (("time", "s", "in time"), ("y", "m", "along y"), ("x", "m", "along x")):
    rows(
        "increments",
        (f"lag_{_axis}", "order"),
        (f"structure_{_axis}", "", f"mean of the differences {_words} to the power p", "field's units ^ p"),
        (f"structure_{_axis}_std", "", "its standard uncertainty"),
    )
    rows(
        "increments",
        (f"lag_{_axis}",),
        (f"lag_{_axis}", _unit, f"lag {_words}"),
        (f"flatness_{_axis}", "1", f"flatness of the differences {_words}", "3 for a Gaussian field"),
        (f"flatness_{_axis}_std", "1", "its standard uncertainty"),
    )
rows("increments", ("order",), ("order", "1", "power p of the structure function"))

# ---- waves and vortices ----
rows(
    "vortices",
    ("omega", "k"),
    ("E_waves", "m3 s-1 rad-2", "spectrum of the velocity along the wave vector"),
    ("E_vortices", "m3 s-1 rad-2", "spectrum of the velocity across the wave vector"),
    ("E_leak", "m3 s-1 rad-2", "what the windows turn across, taken off"),
    ("low", "1", LOW),
    ("high", "1", HIGH),
    ("valid", "1", "where the spectrum can be trusted"),
)
rows(
    "vortices",
    (),
    ("vortical_fraction", "1", "fraction of the variance of (u, v) across the wave vector"),
    ("vortical_fraction_std", "1", "its standard uncertainty"),
)

# ---- paths of the surface water and Stokes drift ----
for _axis in "xy":
    rows("paths", ("start", "path", "age"), (f"path_{_axis}", "m", f"place along {_axis}"))
    rows(
        "paths",
        (),
        (f"drift_{_axis}", "m s-1", f"mean velocity of points of the surface along {_axis}"),
        (f"drift_{_axis}_std", "m s-1", "its standard uncertainty"),
        (f"mean_{_axis}", "m s-1", f"mean velocity at the nodes along {_axis}"),
        (f"mean_{_axis}_std", "m s-1", "its standard uncertainty"),
    )
    rows("drift", ("omega",), (f"stokes_by_omega_{_axis}", "m rad-1", f"Stokes drift along {_axis} by line"))
    rows(
        "drift",
        (),
        (f"stokes_{_axis}", "m s-1", f"Stokes drift at the surface along {_axis}"),
        (f"stokes_{_axis}_std", "m s-1", "its standard uncertainty"),
    )
rows("paths", ("age",), ("age", "s", "time since the start"))
rows("paths", ("start",), ("start_time", "s", "time of the start"))
rows("paths", (), ("stayed", "1", "fraction of the points that stayed in the field"))

# ---- energy budget ----
for _name, _unit, _words in (
    ("energy", "J m-2", "energy of the waves"),
    ("flux_x", "W m-1", "flux of energy along x"),
    ("flux_y", "W m-1", "flux of energy along y"),
    ("growth", "W m-2", "change of the energy in time"),
    ("divergence", "W m-2", "divergence of the flux of energy"),
    ("unexplained", "W m-2", "growth, divergence and viscous loss together"),
):
    rows(
        "budget",
        ("band",),
        (_name, _unit, _words),
        (f"{_name}_std", _unit, "its standard uncertainty"),
    )
rows(
    "budget",
    ("band",),
    ("band", "Hz", "middle of the band"),
    ("viscous", "W m-2", "what viscosity takes, clean water"),
    ("longest_decay", "m", "decay length that the divergence would just show"),
    ("shortest_growth", "s", "time of growth that the record would just show"),
)
