"""Times public Mie programs on the rows of `ditd bench mie`, on one thread.

    python3 -m venv venv
    venv/bin/pip install numpy numba miepython==3.3.0 lxmie==1.1.1 python-scattnlay==2.4
    taskset -c 0 venv/bin/python mie_peers.py            # `--json` for a list, `--only miepython,lxmie` for some
    taskset -c 0 ditd bench mie                          # the same rows of ditd

PyMieScatt needs "numpy<2" "scipy<1.14" and so a venv of its own (`--only PyMieScatt`; its table takes half a minute).

Every number is the minimum of several runs, after one that is not counted (it compiles what is compiled late). A program
that is not installed is skipped. The table is 200 radii (0.1 to 100 um, even in ln r) at 64 wavelengths (3 to 5 um) of a
liquid with one absorption line; its check is the sum of all Q_ext, which is 20037.643124522810 by the textbook series in
256-bit arithmetic. Timed is what each program calls a computation of efficiencies (Q_ext, Q_sca, g, and Q_back where it
has them), through the fastest public way it has for many spheres.
"""

import argparse
import json
import os
import sys
import time

# Before the libraries are loaded.
for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = "1"
os.environ.setdefault("MIEPYTHON_USE_JIT", "1")

import numpy as np  # noqa: E402

SUM_QEXT = 20037.643124522810
SIZES = (1.0, 10.0, 100.0, 1000.0, 10000.0)
N, K = 1.38, 0.09
ANGLES = np.linspace(0.0, 180.0, 181)


def index(um):
    """A liquid with one absorption line near 3.41 um."""
    nu0, gamma, strength = 2930.0, 60.0, 0.02
    nu = 1e4 / um
    d = (nu0 * nu0 - nu * nu) / (nu0 * nu0)
    g = gamma * nu / (nu0 * nu0)
    den = d * d + g * g
    return 1.38 + 0.5 * strength * d / den * 0.1, max(0.5 * strength * g / den * 0.2, 5e-4)


def table():
    """x, n, k of the 12 800 spheres."""
    rows = []
    for w in range(64):
        um = 3.0 + 2.0 * w / 63.0
        n, k = index(um)
        for r in range(200):
            rows.append((2.0 * np.pi * 0.1 * 1000.0 ** (r / 199.0) / um, n, k))
    return np.array(rows).T


def of_miepython():
    import miepython

    def angles(x):
        return miepython.S1_S2(complex(N, -K), x, np.cos(np.radians(ANGLES)), norm="bohren")

    return (
        miepython.__version__,
        lambda x, n, k: miepython.efficiencies_mx(n - 1j * k, x)[0],
        lambda x: miepython.efficiencies_mx(complex(N, -K), x),
        angles,
    )


def of_lxmie():
    from importlib.metadata import version

    import lxmie

    def many(x, n, k):
        return [row.q_ext for row in lxmie.mie(n.tolist(), k.tolist(), x.tolist())]

    return (
        version("lxmie"),
        many,
        lambda x: lxmie.mie(N, K, x),
        lambda x: lxmie.mie_amplitudes(N, K, x, np.radians(ANGLES).tolist()),
    )


def of_scattnlay():
    from importlib.metadata import version

    import scattnlay

    m = np.array([complex(N, K)])
    return (
        version("python-scattnlay"),
        lambda x, n, k: scattnlay.scattnlay(x[:, None], (n + 1j * k)[:, None])[1],
        lambda x: scattnlay.scattnlay(np.array([x]), m),
        lambda x: scattnlay.scattnlay(np.array([x]), m, theta=np.radians(ANGLES)),
    )


def of_pymiescatt():
    from importlib.metadata import version

    import PyMieScatt

    def one(x, n=N, k=K):
        # Wavelength pi makes the diameter the size parameter.
        return PyMieScatt.MieQ(complex(n, k), np.pi, x)

    return version("PyMieScatt"), lambda x, n, k: [one(*row)[0] for row in zip(x, n, k)], one, None


# Where these two take seconds to minutes.
SLOW_ABOVE = {"sphere": 1000.0, "181 angles": 100.0}

PEERS = {
    "miepython": of_miepython,
    "lxmie": of_lxmie,
    "scattnlay": of_scattnlay,
    "PyMieScatt": of_pymiescatt,
}


def minimum(work, seconds):
    """Minimum time of a call, in runs of at least 50 us, for about `seconds`; at least three runs."""
    work()
    begin = time.perf_counter()
    work()
    once = time.perf_counter() - begin
    calls = max(1, int(5e-5 / max(once, 1e-9)))
    best, runs, end = once, 0, time.perf_counter() + seconds
    while runs < 3 or time.perf_counter() < end:
        begin = time.perf_counter()
        for _ in range(calls):
            work()
        best = min(best, (time.perf_counter() - begin) / calls)
        runs += 1
        if once > 20.0:
            break
    return best


def measure(name, seconds):
    """Rows {peer, version, name, seconds, error} of one program."""
    version, many, one, angles = PEERS[name]()
    rows = []

    def add(what, took, error=None):
        rows.append({"peer": name, "version": version, "name": what, "seconds": took, "error": error})
        print(f"{name:12}{version:10}{what:28}{took:14.4g} s" + ("" if error is None else f"   {error:.1e}"), file=sys.stderr)

    spheres = table()
    try:
        error = abs(float(np.sum(many(*spheres))) / SUM_QEXT - 1.0)
        add("table of 12800 spheres", minimum(lambda: many(*spheres), 4.0 * seconds), error)
    except Exception as failure:  # a peer that cannot do it is a result, not an end
        print(f"{name}: table: {failure!r}", file=sys.stderr)
    for kind, work in (("sphere", one), ("181 angles", angles)):
        for x in SIZES:
            if work is None or x > (SLOW_ABOVE[kind] if name in ("scattnlay", "PyMieScatt") else np.inf):
                continue
            try:
                add(f"{kind}, x = {x:g}", minimum(lambda x=x, work=work: work(x), seconds))
            except Exception as failure:
                print(f"{name}: {kind}, x = {x:g}: {failure!r}", file=sys.stderr)
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print a JSON list on standard output")
    parser.add_argument("--only", default=",".join(PEERS), help="programs, separated by commas")
    parser.add_argument("--seconds", type=float, default=0.5, help="time spent on each number (the table: 4 times)")
    args = parser.parse_args()
    rows = []
    for name in args.only.split(","):
        try:
            rows += measure(name, args.seconds)
        except ImportError as failure:
            print(f"{name}: skipped ({failure})", file=sys.stderr)
    if args.json:
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
