"""Everything the waves of one cube have to say, in one store.

The store that :func:`analyze` writes is a Zarr hierarchy; ``xarray.open_datatree(path, engine="zarr")`` reads
it without this package. Every variable carries ``units``, ``long_name`` and, where needed, ``comment``.

Conventions. k points where the wave goes: f = Re sum F exp(i (k . x - omega t)), omega > 0. Spectra are
densities in rad/m and rad/s, one-sided in omega, so that the sum of E over its axes times the cell is the
variance. Coordinates: ``omega`` (rad s-1) with ``frequency`` (Hz) beside it, ``k`` (rad m-1, centres of rings)
with ``cycles`` (m-1) beside it, ``kx`` and ``ky`` (rad m-1). Intervals are factors: the truth lies in
[low E, high E] with 95 % confidence. ``valid`` masks say where a spectrum can be trusted.

``/``
    attributes only: ``source``, ``frame_rate`` (Hz), ``water_depth`` (m; "deep" if unknown), ``segment``
    (steps), ``segments``, ``steps``, ``steps_used``, ``steps_bridged``, ``nodes_filled``, ``x`` and ``y``
    (two numbers each: the rectangle, m), ``runs`` (number of pieces between long gaps), ``degrees_of_freedom``
    (of a single cell), ``notes`` (sentences for the reader, one per line), ``wavefield_version``.

``/spectra``
    dims omega, k; ky, kx; omega_map; source.

    - ``E_komega_z``, ``E_komega_z_t``, ``E_komega_u``, ``E_komega_v``, ``E_komega_w``, ``E_komega_nl``
      (omega, k): E(k, omega), integral over angle. z is at frame times; nl is u . grad z.
    - ``coverage`` (k): share of the ring inside the sampled plane; ``cells`` (k): its independent cells.
      The azimuthal mean is E / (2 pi k coverage).
    - ``dof_komega``, ``low_komega``, ``high_komega`` (k); ``valid_komega`` (omega, k).
    - ``E_k_z`` ... ``E_k_nl`` (k): E(k) = integral over omega.
    - ``E_z``, ``E_z_t``, ``E_u``, ``E_v``, ``E_w``, ``E_nl`` (omega): integral over k, as measured;
      ``dof_z`` ..., ``low_z`` ..., ``high_z`` ... (omega).
    - ``Ez_stereo``, ``Ez_w``, ``Ez_cross``, ``Ez_fusion`` and, with probes, ``Ez_probes`` (omega): the spectrum
      of the elevation, m2 s rad-1, by five roads (transfer functions undone; fusion has its noise taken off),
      each with ``valid_...`` (omega, bool) and ``dof_...``, ``low_...``, ``high_...`` (omega).
    - ``Ez_probe`` (probe, omega): each probe by itself; coordinates probe (name), probe_x, probe_y.
    - ``gain_two_frames``, ``gain_four_frames``, ``gain_displacement`` (omega): the power transfer functions.
    - ``E_kxky_z``, ``E_kxky_w`` (omega_map, ky, kx): maps at chosen frequencies, the paper's 2.8 Hz among them.

``/coherence``
    dims k; omega, k.

    - ``C_w``, ``C_nl``, ``C_tot`` (k), complex: of z_t with w, -u . grad z, and their sum; one normalisation,
      so that C_w + C_nl = C_tot; |C_w| may exceed 1. Plot the modulus for the paper's curves.
    - ``gamma2_w``, ``gamma2_nl``, ``gamma2_tot`` (k): standard magnitude-squared coherence, 0 to 1.
    - ``samples`` (k): effective number of independent samples; ``bias`` = 1 / samples; ``level`` (k): what
      unrelated signals exceed in 5 % of cases (compare with gamma2).
    - the same with ``_komega`` at the end: (omega, k); ``samples_komega``, ``level_komega`` (k).

``/kinematics``
    dims step; scalars.

    - ``w_rms``, ``z_t_rms``, ``nonlinear_rms``, ``residual_rms``, ``finite_residual_rms`` (step), m s-1:
      over the rectangle, at the sampled steps (coordinate ``time``, s); the residual is z_t - w + u . grad z,
      ``finite`` its exact form for finite displacements.
    - ``nonlinear_share`` = rms(nl) / rms(w), ``residual_share`` = rms(residual) / rms(nl),
      ``finite_residual_share`` (scalars).
    - ``vorticity_rms``, ``divergence_rms`` (step), s-1.

``/statistics``
    dims bin; quantity.

    - ``pdf`` (quantity, bin), ``gaussian`` (bin), in standard deviations: coordinate ``bin`` = (value - mean) /
      std, quantity = z, dx, dy, dz (the displacements over one time step).
    - ``mean``, ``std``, ``skewness``, ``kurtosis`` (excess), ``count`` (quantity); mean and std in metres.
    - ``std_px`` (quantity): in pixels, where the cube says how large a pixel is (``pixel_size``, m).
    - scalars: ``significant_height`` (Hs = 4 sigma, m), ``steepness`` (k_p sigma), ``mean_square_slope``,
      ``slope_rms``, ``peak_frequency`` (Hz), ``peak_k`` (rad m-1).
    - errors, where the cube has them: ``eps_y_mean``, ``eps_y_std`` (m), ``eps_piv_rms`` (px),
      ``eps_pdf`` (error, eps_bin) over ``eps_bin`` in standard deviations.

``/dispersion``
    dims k; point.

    - ``omega_theory`` (k) without current; ``omega_fit`` (k) with the fitted gamma, no current.
    - ``ridge_k``, ``ridge_omega``, ``ridge_angle``, ``ridge_weight`` (point): the measured ridge.
    - ``ridge_omega_mean``, ``ridge_error`` (band; coordinate ``band_frequency``, Hz): the ridge against the
      theory, relative, by bands of frequency.
    - scalars: ``current_x``, ``current_y`` (m s-1), ``gamma`` (m3 s-2), each with ``..._std``;
      ``ridge_share``: share of the variance of w within the ridge; ``depth`` (m).

``/fusion``
    dims omega.

    - ``noise_z``, ``noise_w`` (omega): noise of the stereo elevation and of the integrated w, m2 s rad-1;
      ``noise_z_fit``, ``noise_w_fit``: their white fits.
    - ``weight_z`` (omega): weight of the stereo elevation in the best combination; ``wiener`` (omega).
    - scalars: ``sigma_z`` (m), ``sigma_dz`` (m): noise of z and of the displacement, without a rest record;
      ``noise_coherence``: correlation of the two off the ridge, on which the gain depends.
    - ``range_frequency``, ``range_decades`` (road): how far each road reaches above its own noise; coordinate
      road = stereo, w, cross, fusion.

``/direction``
    dims omega_map, theta.

    - ``D`` (omega_map, theta): directional density of the waves on the ridge, rad-1, its integral is 1;
      ``dof_D``; ``isotropy`` (omega): 1 - |first and second harmonic|, 1 for an isotropic sea.

``/higher_order``
    dims omega1, omega2.

    - ``bicoherence`` (omega1, omega2) in [0, 1], ``bicoherence_level`` what phase-randomised surrogates exceed in
      5 % of cases; ``bicoherence_samples``.
    - ``tricoherence`` (omega1, omega2): at the best omega3, trivial pairings left out; ``tricoherence_omega3``;
      ``tricoherence_level``.
"""
