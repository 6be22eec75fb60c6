//! Counter-based random numbers: Owen-scrambled Sobol points for the leading dimensions, hashes beyond.
//!
//! A number is a pure function of (seed, index, dimension), so results do not depend on the number of threads.

/// Dimensions with low discrepancy; later ones are independent hashes.
pub(super) const SOBOL_DIMENSIONS: usize = 16;

/// Degree, coefficients and initial numbers of the primitive polynomials for dimensions 2 to 16:
/// S. Joe and F. Y. Kuo, SIAM J. Sci. Comput. 30, 2635 (2008), table new-joe-kuo-6.
const POLYNOMIALS: [(usize, u32, [u32; 6]); SOBOL_DIMENSIONS - 1] = [
    (1, 0, [1, 0, 0, 0, 0, 0]),
    (2, 1, [1, 3, 0, 0, 0, 0]),
    (3, 1, [1, 3, 1, 0, 0, 0]),
    (3, 2, [1, 1, 1, 0, 0, 0]),
    (4, 1, [1, 1, 3, 3, 0, 0]),
    (4, 4, [1, 3, 5, 13, 0, 0]),
    (5, 2, [1, 1, 5, 5, 17, 0]),
    (5, 4, [1, 1, 5, 5, 5, 0]),
    (5, 7, [1, 1, 7, 11, 19, 0]),
    (5, 11, [1, 1, 5, 1, 1, 0]),
    (5, 13, [1, 1, 1, 3, 11, 0]),
    (5, 14, [1, 3, 5, 5, 31, 0]),
    (6, 1, [1, 3, 3, 9, 7, 49]),
    (6, 13, [1, 1, 1, 15, 21, 21]),
    (6, 16, [1, 3, 1, 13, 27, 49]),
];

static DIRECTIONS: [[u32; 32]; SOBOL_DIMENSIONS] = directions();

const fn directions() -> [[u32; 32]; SOBOL_DIMENSIONS] {
    let mut table = [[0_u32; 32]; SOBOL_DIMENSIONS];
    let mut bit = 0;
    while bit < 32 {
        table[0][bit] = 1 << (31 - bit);
        bit += 1;
    }
    let mut dimension = 1;
    while dimension < SOBOL_DIMENSIONS {
        let (degree, coefficients, initial) = POLYNOMIALS[dimension - 1];
        let mut i = 0;
        while i < 32 {
            table[dimension][i] = if i < degree {
                initial[i] << (31 - i)
            } else {
                let mut v = table[dimension][i - degree] ^ (table[dimension][i - degree] >> degree);
                let mut k = 1;
                while k < degree {
                    if (coefficients >> (degree - 1 - k)) & 1 == 1 {
                        v ^= table[dimension][i - k];
                    }
                    k += 1;
                }
                v
            };
            i += 1;
        }
        dimension += 1;
    }
    table
}

/// Direction numbers with their bits reversed, summed up: what changes from point i to i + 1 is entry
/// trailing_zeros(i + 1).
static STEPS: [[u32; SOBOL_DIMENSIONS]; 32] = steps();

const fn steps() -> [[u32; SOBOL_DIMENSIONS]; 32] {
    let mut table = [[0_u32; SOBOL_DIMENSIONS]; 32];
    let mut dimension = 0;
    while dimension < SOBOL_DIMENSIONS {
        let mut bit = 0;
        let mut sum = 0;
        while bit < 32 {
            sum ^= DIRECTIONS[dimension][bit].reverse_bits();
            table[bit][dimension] = sum;
            bit += 1;
        }
        dimension += 1;
    }
    table
}

/// A scrambled sequence, its keys at hand.
#[derive(Debug, Clone)]
pub(super) struct Sequence {
    seed: u32,
    keys: [u32; SOBOL_DIMENSIONS],
}

impl Sequence {
    /// The sequence named `seed`.
    pub(super) fn new(seed: u32) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "sixteen dimensions")]
        let keys = std::array::from_fn(|dimension| key(seed, dimension as u32));
        Self { seed, keys }
    }

    /// Its points from `index` on, one after the other.
    #[inline(always)]
    pub(super) fn from(&self, index: u32) -> Run<'_> {
        let mut state = [0_u32; SOBOL_DIMENSIONS];
        let mut rest = index;
        while rest != 0 {
            let bit = rest.trailing_zeros() as usize;
            for d in 0..SOBOL_DIMENSIONS {
                state[d] ^= DIRECTIONS[d][bit].reverse_bits();
            }
            rest &= rest - 1;
        }
        Run { sequence: self, state, index }
    }
}

/// Consecutive points of a sequence: what [`Point`] gives, all leading coordinates at once.
pub(super) struct Run<'a> {
    sequence: &'a Sequence,
    state: [u32; SOBOL_DIMENSIONS],
    index: u32,
}

/// The coordinates of one point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Coordinates {
    bits: [u32; SOBOL_DIMENSIONS],
    seed: u32,
    index: u32,
}

impl Run<'_> {
    /// The next point.
    #[inline(always)]
    pub(super) fn next(&mut self) -> Coordinates {
        let mut bits = [0; SOBOL_DIMENSIONS];
        for (bits, (state, key)) in bits.iter_mut().zip(self.state.iter().zip(&self.sequence.keys)) {
            *bits = scramble_reversed(*state, *key);
        }
        let index = self.index;
        self.index = index.wrapping_add(1);
        let step = &STEPS[(self.index.trailing_zeros() as usize).min(31)];
        for (state, step) in self.state.iter_mut().zip(step) {
            *state ^= step;
        }
        Coordinates { bits, seed: self.sequence.seed, index }
    }
}

impl Coordinates {
    /// Coordinate `dimension`, strictly between 0 and 1.
    #[inline(always)]
    pub(super) fn get(&self, dimension: usize) -> f64 {
        (f64::from(self.bits(dimension)) + 0.5) * (1.0 / 4_294_967_296.0)
    }

    /// The bits of coordinate `dimension`.
    #[inline(always)]
    pub(super) fn bits(&self, dimension: usize) -> u32 {
        if dimension < SOBOL_DIMENSIONS {
            self.bits[dimension]
        } else {
            #[expect(clippy::cast_possible_truncation, reason = "dimensions are counted in thousands")]
            beyond(key(self.seed, dimension as u32), self.index)
        }
    }
}

#[inline]
fn key(seed: u32, dimension: u32) -> u32 {
    hash(seed ^ hash(dimension ^ 0x5bd1_e995))
}

/// Dimensions without low discrepancy.
#[inline]
fn beyond(key: u32, index: u32) -> u32 {
    hash(key ^ hash(index.wrapping_mul(0x9e37_79b9) ^ key.rotate_left(16)))
}

/// Point number `index` of one scrambled sequence.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    seed: u32,
    index: u32,
}

impl Point {
    /// Point `index` of the sequence named `seed`.
    pub(super) fn new(seed: u32, index: u32) -> Self {
        Self { seed, index }
    }

    /// Coordinate `dimension`, strictly between 0 and 1.
    #[inline]
    pub(super) fn coordinate(self, dimension: usize) -> f64 {
        #[expect(clippy::cast_possible_truncation, reason = "dimensions are counted in hundreds")]
        let key = key(self.seed, dimension as u32);
        let bits = if dimension < SOBOL_DIMENSIONS {
            scramble_reversed(sobol(self.index, dimension).reverse_bits(), key)
        } else {
            beyond(key, self.index)
        };
        (f64::from(bits) + 0.5) * (1.0 / 4_294_967_296.0)
    }
}

#[inline]
fn sobol(index: u32, dimension: usize) -> u32 {
    let matrix = &DIRECTIONS[dimension];
    let mut rest = index;
    let mut value = 0;
    while rest != 0 {
        value ^= matrix[(rest.trailing_zeros() & 31) as usize];
        rest &= rest - 1;
    }
    value
}

/// Nested uniform scrambling by a hash that only lets low bits act on high ones: Laine and Karras, Comput. Graph.
/// Forum 30, 1265 (2011), with the constants of N. Vegdahl (2021). Takes a value with its bits reversed.
#[inline(always)]
fn scramble_reversed(reversed: u32, key: u32) -> u32 {
    let mut x = reversed;
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(key);
    x = x.wrapping_mul((key >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// A 32-bit mixing function (C. Wellons, "lowbias32").
#[inline]
pub(super) fn hash(value: u32) -> u32 {
    let mut x = value;
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// A hash of a number's bits.
#[inline]
pub(super) fn hash_of(value: f64) -> u32 {
    #[expect(clippy::cast_possible_truncation, reason = "the two halves are mixed")]
    let (low, high) = (value.to_bits() as u32, (value.to_bits() >> 32) as u32);
    hash(low ^ hash(high))
}

/// The name of a sequence made from a seed and two counters.
#[inline]
pub(super) fn sequence(seed: u64, first: u32, second: u32) -> u32 {
    #[expect(clippy::cast_possible_truncation, reason = "the two halves are mixed")]
    let folded = hash(seed as u32).wrapping_add(hash((seed >> 32) as u32 ^ 0x68e3_1da4));
    hash(hash(folded ^ hash(first)).wrapping_add(hash(second ^ 0xb529_7a4d)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every elementary interval of size 2^−k holds exactly one of 2^k points, in each dimension.
    #[test]
    fn each_dimension_is_stratified() {
        for dimension in 0..SOBOL_DIMENSIONS {
            for seed in [1, 77] {
                let mut seen = [false; 256];
                for index in 0..256 {
                    let x = Point::new(seed, index).coordinate(dimension) * 256.0;
                    let cell = (0..256).rev().find(|&c| x >= c as f64).unwrap();
                    assert!(!seen[cell], "dimension {dimension} seed {seed}");
                    seen[cell] = true;
                }
            }
        }
    }

    #[test]
    fn a_run_gives_the_points_themselves() {
        let sequence = Sequence::new(91);
        for start in [0, 1, 7, 1023, u32::MAX - 3] {
            let mut run = sequence.from(start);
            for i in 0..40 {
                let (point, coordinates) = (Point::new(91, start.wrapping_add(i)), run.next());
                for dimension in 0..SOBOL_DIMENSIONS + 3 {
                    assert_eq!(point.coordinate(dimension).to_bits(), coordinates.get(dimension).to_bits());
                }
            }
        }
    }

    #[test]
    fn pairs_of_dimensions_are_uncorrelated() {
        let n = 4096;
        for a in 0..24 {
            for b in a + 1..24 {
                let sum: f64 = (0..n)
                    .map(|i| {
                        let point = Point::new(5, i);
                        (point.coordinate(a) - 0.5) * (point.coordinate(b) - 0.5)
                    })
                    .sum();
                // The product has variance 1/144; 5σ of its mean over n points.
                assert!((sum / f64::from(n)).abs() < 5.0 / 12.0 / f64::from(n).sqrt(), "{a} {b}");
            }
        }
    }
}
