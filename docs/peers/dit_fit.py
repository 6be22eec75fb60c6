"""Times Python fits of the map of `ditd bench fit --only speed`, on one thread.

    python3 -m venv venv
    venv/bin/pip install numpy scipy numba
    taskset -c 0 venv/bin/python dit_fit.py              # `--json` for a list, `--pixels N` of the per-pixel fits
    taskset -c 0 ditd bench fit --only speed             # ditd on frames of the same kind

50 pairs of 640 x 512 frames, five plate levels, the paper's weights n/max(s^2, 1/12), a spray of emissivity 0.05 to 0.93 and
395 to 500 K that changes from shot to shot. Every time is the minimum of several runs, after one that is not counted.
Fits pixel by pixel run on some pixels and are scaled to all of them: they are here for the record. The error is the rms
of T where the emissivity is above 0.2, so that time can be read against what it buys; scipy's fits give the temperature of
the same weights and hence the same error.
"""

import argparse
import json
import os
import time

for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402

ROWS, COLUMNS, CYCLES = 512, 640, 10
PLATES_K = np.array([373.0, 403.0, 433.0, 498.0, 533.0])
A, A_UM, B_UM_K, C2 = 7.2e5, 3.4, 1.5, 14387.768775
GAMMA, PLATE, OFFSET = 0.95, 0.99, 1500.0


def counts_of(t):
    return A / np.expm1(C2 / (A_UM * t + B_UM_K))


def kelvin_of(counts):
    with np.errstate(all="ignore"):
        t = (C2 / np.log1p(A / counts) - B_UM_K) / A_UM
    return np.where(counts > 0, t, np.nan)


X = GAMMA * counts_of(PLATES_K)


def shots(seed=77):
    """Frames of all levels, u16 [level, cycle, row, column]: blanks and sprays; and the ensemble's truth."""
    rng = np.random.default_rng(seed)
    emissivity = np.broadcast_to(np.linspace(0.05, 0.93, COLUMNS), (ROWS, COLUMNS))
    kelvin = np.broadcast_to(np.linspace(395.0, 500.0, ROWS)[:, None], (ROWS, COLUMNS))
    depth = -np.log1p(-emissivity)
    shape = (len(PLATES_K), CYCLES, ROWS, COLUMNS)
    blank, spray = np.empty(shape, np.uint16), np.empty(shape, np.uint16)

    def draw(u, v):
        w = -0.4 * u + np.sqrt(1 - 0.16) * v
        e = -np.expm1(-depth * np.exp(0.25 * u))
        return e, e * counts_of(kelvin + 5.0 * w) / PLATE

    def sample(signal):
        sigma = np.sqrt(1.2**2 + np.maximum(signal, 0) / 500.0)
        return np.rint(OFFSET + signal + sigma * rng.standard_normal(signal.shape)).astype(np.uint16)

    for k, x in enumerate(X):
        for c in range(CYCLES):
            e, es = draw(rng.standard_normal((ROWS, COLUMNS)), rng.standard_normal((ROWS, COLUMNS)))
            blank[k, c] = sample(np.full((ROWS, COLUMNS), GAMMA * x))
            spray[k, c] = sample(GAMMA * (x + es - e * x))
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    mean_e, mean_es = np.zeros_like(depth), np.zeros_like(depth)
    for u, wu in zip(nodes, weights):
        for v, wv in zip(nodes, weights):
            e, es = draw(u, v)
            mean_e, mean_es = mean_e + wu * wv * e, mean_es + wu * wv * es
    return blank, spray, mean_e / (2 * np.pi), kelvin_of(PLATE * mean_es / mean_e)


def statistics(blank, spray):
    """Mean and variance of spray - blank per level, one pair at a time, as frames arrive."""
    mean, variance = [], []
    for b, s in zip(blank, spray):
        total = np.zeros((ROWS, COLUMNS), np.int32)
        squares = np.zeros((ROWS, COLUMNS), np.float64)
        for one, other in zip(b, s):
            y = other.astype(np.int32) - one
            total += y
            squares += y * y
        m = total / CYCLES
        mean.append(m)
        variance.append((squares - CYCLES * m * m) / (CYCLES - 1))
    return np.array(mean), np.array(variance)


def vectorised(blank, spray):
    mean, variance = statistics(blank, spray)
    return weighted(mean, variance)


def weighted(mean, variance):
    w = CYCLES / np.maximum(variance, 1 / 12)
    x = X[:, None, None]
    total = w.sum(0)
    xm, ym = (w * x).sum(0) / total, (w * mean).sum(0) / total
    dx, dy = x - xm, mean - ym
    sxx, sxy = (w * dx * dx).sum(0), (w * dx * dy).sum(0)
    slope = sxy / sxx
    crossing = xm - ym / slope
    t = kelvin_of(PLATE * crossing)
    sigma_s = np.sqrt(1 / total + (crossing - xm) ** 2 / sxx) / np.abs(slope)
    wide = A_UM * t + B_UM_K
    counts = PLATE * crossing
    sigma_t = sigma_s * PLATE * wide**2 / (counts * (1 + counts / A) * C2 * A_UM)
    return t, sigma_t, -slope / GAMMA, np.sqrt(1 / sxx) / GAMMA


def numba_fit():
    try:
        import numba
    except ImportError:
        return None

    @numba.njit(fastmath=True)
    def fit(blank, spray, x, out):
        levels, cycles, rows, columns = blank.shape
        total = np.zeros((levels, rows, columns), np.int32)
        squares = np.zeros((levels, rows, columns), np.float64)
        for k in range(levels):
            for c in range(cycles):
                for r in range(rows):
                    for i in range(columns):
                        y = np.int32(spray[k, c, r, i]) - np.int32(blank[k, c, r, i])
                        total[k, r, i] += y
                        squares[k, r, i] += np.float64(y) * np.float64(y)
        for r in range(rows):
            for i in range(columns):
                sw, swx, swy = 0.0, 0.0, 0.0
                for k in range(levels):
                    m = total[k, r, i] / cycles
                    v = (squares[k, r, i] - cycles * m * m) / (cycles - 1)
                    w = cycles / max(v, 1 / 12)
                    sw += w
                    swx += w * x[k]
                    swy += w * m
                xm, ym = swx / sw, swy / sw
                sxx, sxy = 0.0, 0.0
                for k in range(levels):
                    m = total[k, r, i] / cycles
                    v = (squares[k, r, i] - cycles * m * m) / (cycles - 1)
                    w = cycles / max(v, 1 / 12)
                    dx = x[k] - xm
                    sxx += w * dx * dx
                    sxy += w * dx * (m - ym)
                slope = sxy / sxx
                crossing = xm - ym / slope
                counts = PLATE * crossing
                t = np.nan
                if counts > 0:
                    t = (C2 / np.log1p(A / counts) - B_UM_K) / A_UM
                wide = A_UM * t + B_UM_K
                sigma = np.sqrt(1 / sw + (crossing - xm) ** 2 / sxx) / abs(slope)
                out[0, r, i] = t
                out[1, r, i] = sigma * PLATE * wide * wide / (counts * (1 + counts / A) * C2 * A_UM)
                out[2, r, i] = -slope / GAMMA
                out[3, r, i] = np.sqrt(1 / sxx) / GAMMA

    out = np.empty((4, ROWS, COLUMNS))

    def run(blank, spray):
        fit(blank, spray, X, out)
        return out

    return run


def each_pixel(blank, spray, pixels, how):
    """Seconds for all pixels and temperatures of some, one call of a fitter per pixel."""
    mean, variance = statistics(blank, spray)
    chosen = np.linspace(0, ROWS * COLUMNS - 1, pixels).astype(int)
    y, v = mean.reshape(len(X), -1)[:, chosen], variance.reshape(len(X), -1)[:, chosen]
    begin = time.process_time()
    t = np.array([how(y[:, i], np.sqrt(np.maximum(v[:, i], 1 / 12) / CYCLES)) for i in range(pixels)])
    return (time.process_time() - begin) * ROWS * COLUMNS / pixels, t, chosen


def polyfit(y, sigma):
    slope, offset = np.polyfit(X, y, 1, w=1 / sigma)
    return kelvin_of(PLATE * -offset / slope)


def curve_fit_of():
    try:
        from scipy.optimize import curve_fit
    except ImportError:
        return None

    def fit(y, sigma):
        (slope, offset), _ = curve_fit(lambda x, a, b: a * x + b, X, y, sigma=sigma, absolute_sigma=True)
        return kelvin_of(PLATE * -offset / slope)

    return fit


def fastest(work, runs):
    work()
    best = np.inf
    for _ in range(runs):
        begin = time.process_time()
        answer = work()
        best = min(best, time.process_time() - begin)
    return best, answer


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--pixels", type=int, default=1000)
    parser.add_argument("--runs", type=int, default=10)
    options = parser.parse_args()
    blank, spray, emissivity, kelvin = shots()
    figures = []

    def error(t, where=slice(None)):
        e, k = emissivity.ravel()[where], kelvin.ravel()[where]
        off = (t.ravel() - k)[(e > 0.2) & np.isfinite(t.ravel())]
        return float(np.sqrt((off**2).mean()))

    def say(name, seconds, t, where=slice(None)):
        figures.append({"name": name, "seconds": seconds, "error": error(t, where), "threads": 1,
                        "error_kind": "rms of T where emissivity > 0.2, K", "n": ROWS * COLUMNS, "seed": 77})

    seconds, answer = fastest(lambda: vectorised(blank, spray), options.runs)
    say("50 raw pairs to map, paper's weights: numpy, all pixels at once", seconds, answer[0])
    mean, variance = statistics(blank, spray)
    seconds, answer = fastest(lambda: weighted(mean, variance), options.runs)
    say("solve, paper's weights: numpy, all pixels at once", seconds, answer[0])
    compiled = numba_fit()
    if compiled:
        seconds, answer = fastest(lambda: compiled(blank, spray), options.runs)
        say("50 raw pairs to map, paper's weights: numba", seconds, answer[0])
    for name, how in (("numpy.polyfit", polyfit), ("scipy.optimize.curve_fit", curve_fit_of())):
        if how:
            seconds, t, where = each_pixel(blank, spray, options.pixels, how)
            say(f"solve, paper's weights: {name} pixel by pixel", seconds, t, where)
    if options.json:
        print(json.dumps(figures, indent=1))
        return
    for figure in figures:
        print(f"{figure['name']:66} {figure['seconds'] * 1e3:12.1f} ms {figure['error']:8.2f} K")


if __name__ == "__main__":
    main()
