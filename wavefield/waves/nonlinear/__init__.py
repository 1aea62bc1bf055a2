"""The nonlinear term, coherences, bound waves and resonances."""
