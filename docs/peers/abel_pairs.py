"""Writes tests/data/abel/pairs.json: analytic Abel pairs and what PyAbel makes of them.

    pip install PyAbel numpy scipy
    python abel_pairs.py > tests/data/abel/pairs.json

Pairs are those of abel.tools.transform_pairs (profiles 1 to 7, from the papers named there) and a Gaussian. `odd` has
radii i/(n - 1) from the axis on (an odd image of 2n - 1 columns), `even` radii (i + 1/2)/n (an even image of 2n columns,
which PyAbel does not invert: analytic values only).
"""
import json

import abel
import numpy as np
from abel.tools import transform_pairs

N = 41


def pair(name, r):
    if name == "gaussian":
        return np.exp(-((r / 0.3) ** 2)), 0.3 * np.sqrt(np.pi) * np.exp(-((r / 0.3) ** 2))
    # The profiles ask for 0 < r < 1.
    f, p = getattr(transform_pairs, name)(np.clip(r, 1e-8, 1 - 1e-8))
    return f, p


out = {"pyabel": abel.__version__, "n": N, "pairs": []}
for name in [f"profile{k}" for k in range(1, 8)] + ["gaussian"]:
    r = np.linspace(0, 1, N)
    dr = r[1]
    f, p = pair(name, r)
    methods = {
        "three_point": abel.dasch.three_point_transform(p, dr=dr, basis_dir=None),
        "onion_peeling": abel.dasch.onion_peeling_transform(p, dr=dr, basis_dir=None),
        "daun": abel.daun.daun_transform(p, dr=dr, degree=1, verbose=False),
        "daun_100": abel.daun.daun_transform(p, dr=dr, degree=1, reg=("diff", 100), verbose=False),
        **{f"daun_degree_{k}": abel.daun.daun_transform(p, dr=dr, degree=k, verbose=False) for k in (0, 2, 3)},
        "daun_degree_3_100": abel.daun.daun_transform(p, dr=dr, degree=3, reg=("diff", 100), verbose=False),
        "hansenlaw": abel.hansenlaw.hansenlaw_transform(p, dr=dr, direction="inverse", hold_order=1),
        "basex": abel.basex.basex_transform(p, dr=dr, basis_dir=None, verbose=False),
        "basex_10": abel.basex.basex_transform(p, dr=dr, reg=10, basis_dir=None, verbose=False),
    }
    half = (np.arange(N) + 0.5) / N
    f_half, p_half = pair(name, half)
    out["pairs"].append(
        {
            "name": name,
            "odd": {"dr": dr, "f": f.tolist(), "p": p.tolist()},
            "even": {"dr": 1 / N, "f": f_half.tolist(), "p": p_half.tolist()},
            "methods": {key: np.ravel(value).tolist() for key, value in methods.items()},
        }
    )
# Numbers to twelve digits: more than any bound of the tests.
text = json.dumps(out, allow_nan=False, default=float)
print(json.dumps(json.loads(text, parse_float=lambda s: float(f"{float(s):.12g}"))))
