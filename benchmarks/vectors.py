"""Are the inner loops of matching vector code? `python -m benchmarks.vectors` counts vector multiply-adds.

A loop that the compiler no longer turns into vector code is right, and several times slower.
"""

import re
import sys
import tempfile

from numba import config

ASKED = {
    "gradient_moments": 10,
    "plain_sums": 60,
    "robust_sums": 60,
    "final_sums": 60,
    "unweighted_sums": 60,
}


def main() -> int:
    """Compile anew, for the machine code of a cached kernel is not kept, and count."""
    import llvmlite.binding as llvm
    import numpy as np

    features = llvm.get_host_cpu_features()
    if not (features.get("fma") and features.get("avx2")):
        print("this processor has no vector multiply-add")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        config.CACHE_DIR = folder
        from wavefield.matching import MatchSettings, match, matching_kernels

        image = np.random.default_rng(0).normal(size=(100, 100)).astype(np.float32)
        for settings in (MatchSettings.piv(), MatchSettings.stereo()):
            match(image, image, settings)
    lost = 0
    print(f"{'kernel':20} {'asked':>6} {'found':>6}")
    for name, least in ASKED.items():
        code = "".join(getattr(matching_kernels, name).inspect_asm().values())
        found = len(re.findall(r"vfn?m(?:add|sub)[0-9]+ps\s[^\n]*[yz]mm", code))
        lost += found < least
        print(f"{name:20} {least:6} {found:6}  {'NOT REACHED' if found < least else 'reached'}")
    return min(lost, 1)


if __name__ == "__main__":
    sys.exit(main())
