"""Choose among given candidates with figaroh's `Detmax`; runs in that package's own environment.

python choose_figaroh.py CANDIDATES.npz COUNT SEED      prints one line of JSON
"""

from __future__ import annotations

import json
import random
import sys
import time

import numpy as np
from figaroh.optimal.base_optimal_calibration import Detmax


def main(path: str, count: int, seed: int) -> None:
    """Choose once, print processor time and indices."""
    matrices = np.load(path)["information"]
    random.seed(seed)
    start = time.process_time()
    detmax = Detmax(dict(enumerate(matrices)), count)
    chosen: list[int] = []
    original = detmax.get_critD

    def watched(indices: list[int]) -> float:
        chosen[:] = indices  # its result stays in a local variable; the last set it looks at is the one it ends with
        return original(indices)

    detmax.get_critD = watched
    history = detmax.main_algo()
    seconds = time.process_time() - start
    print(json.dumps({"seconds": seconds, "chosen": [int(i) for i in chosen], "rounds": len(history)}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
