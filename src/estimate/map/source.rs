//! Where sums of rows come from: exact sums of a whole image, or recorded cycles that are all at hand, of which some rows
//! are summed at a time. Those sums stay in the second-level cache: the whole image's are never written and read again.

use crate::estimate::accumulate::{AccumulateError, Cycle, LevelSums, Sums};

/// Bytes of the sums that are formed in one go: a third of a second-level cache of a megabyte.
const BAND_BYTES: usize = 360 << 10;

/// Bytes of a pixel and level in sums of not too many cycles of 14 bit.
const CELL_BYTES: usize = 14;

/// Recorded cycles of every level of a map, all at hand.
#[derive(Debug)]
pub struct Shots<'a> {
    /// Of no cycle: shape and settings.
    like: Sums,
    levels: Vec<Vec<Cycle<'a>>>,
}

impl<'a> Shots<'a> {
    /// Cycles of each level, `[level][cycle]`, that `like` could take; what `like` holds does not matter.
    ///
    /// # Errors
    ///
    /// [`AccumulateError`] for a number of levels, a shape or a number of blanks that is not that of `like`, or for more
    /// cycles of a level than sums can hold.
    pub fn new(like: &Sums, levels: Vec<Vec<Cycle<'a>>>) -> Result<Self, AccumulateError> {
        if levels.len() != like.levels().len() {
            return Err(AccumulateError::Level { level: levels.len(), levels: like.levels().len() });
        }
        let (rows, columns, saturation) = (like.rows(), like.columns(), like.saturation_count());
        for (level, cycles) in levels.iter().enumerate() {
            cycles.iter().try_for_each(|cycle| like.check(level, cycle.blanks, cycle.spray))?;
            if u32::try_from(cycles.len()).is_ok_and(|held| held <= like.cycles_max()) {
                continue;
            }
            return Err(AccumulateError::Full { level, cycles: like.cycles_max() });
        }
        let like = Sums::new(levels.len(), rows, columns, like.blanks_per_cycle(), saturation)?;
        Ok(Self { like, levels })
    }

    /// The sums of all of them.
    ///
    /// # Errors
    ///
    /// None that [`Self::new`] would have let through.
    pub fn sums(&self) -> Result<Sums, AccumulateError> {
        let mut sums = self.like.clone();
        for (level, cycles) in self.levels.iter().enumerate() {
            sums.add_cycles(level, cycles)?;
        }
        Ok(sums)
    }

    /// Whether any pixel has two cycles of a level that count.
    pub(super) fn repeats(&self, level: usize) -> bool {
        let saturation = self.like.saturation_count();
        let pixels = self.like.rows() * self.like.columns();
        let counts = |cycle: &Cycle<'_>, pixel: usize| {
            cycle.spray[pixel] < saturation && cycle.blanks.iter().all(|blank| blank[pixel] < saturation)
        };
        let twice = |pixel| self.levels[level].iter().filter(|cycle| counts(cycle, pixel)).nth(1).is_some();
        self.levels[level].len() >= 2 && (0..pixels).any(twice)
    }

    /// Rows that are summed in one go.
    fn band_rows(&self) -> usize {
        let row = CELL_BYTES * self.like.columns() * self.levels.len();
        (BAND_BYTES / row.max(1)).clamp(1, self.like.rows().max(1))
    }
}

/// What a map is fitted to.
#[derive(Debug, Clone, Copy)]
pub(super) enum Source<'a> {
    /// Sums of all rows.
    Sums(&'a Sums),
    /// Cycles to be summed.
    Shots(&'a Shots<'a>),
}

impl<'a> Source<'a> {
    /// Shape and settings; sums that may hold nothing.
    pub(super) fn like(self) -> &'a Sums {
        match self {
            Self::Sums(sums) => sums,
            Self::Shots(shots) => &shots.like,
        }
    }
}

/// Sums of the rows that are worked on.
pub(super) struct Held<'a> {
    source: Source<'a>,
    /// Of some rows from `first` on, where they are summed here.
    band: Option<Sums>,
    first: usize,
}

impl<'a> Held<'a> {
    pub(super) fn new(source: Source<'a>) -> Self {
        Self { source, band: None, first: 0 }
    }

    /// Sums that hold `row`, and the row of the image that they begin with.
    #[inline(always)]
    pub(super) fn of(&self) -> (&Sums, usize) {
        match (self.source, &self.band) {
            (Source::Sums(sums), _) => (sums, 0),
            (Source::Shots(shots), None) => (&shots.like, 0),
            (Source::Shots(_), Some(band)) => (band, self.first),
        }
    }

    /// Levels of those sums.
    #[inline(always)]
    pub(super) fn levels(&self) -> &[LevelSums] {
        self.of().0.levels()
    }

    /// Makes sure that a row is there.
    pub(super) fn hold(&mut self, row: usize) {
        let Source::Shots(shots) = self.source else { return };
        let height = shots.band_rows();
        if self.band.is_some() && (self.first..self.first + height).contains(&row) {
            return;
        }
        let like = &shots.like;
        let (levels, columns, blanks) = (shots.levels.len(), like.columns(), like.blanks_per_cycle());
        let fresh = || {
            Sums::new(levels, height, columns, blanks, like.saturation_count())
                .expect("settings of other sums")
        };
        let band = self.band.get_or_insert_with(fresh);
        band.clear();
        self.first = row.min(like.rows() - height);
        let pixels = self.first * columns..(self.first + height) * columns;
        let mut cut: Vec<&[u16]> = Vec::new();
        for (level, cycles) in shots.levels.iter().enumerate() {
            cut.clear();
            let blanks_of = cycles.iter().flat_map(|cycle| cycle.blanks);
            cut.extend(blanks_of.map(|blank| &blank[pixels.clone()]));
            let of_cycle = cycles.iter().zip(cut.chunks(usize::from(blanks)));
            let cycles: Vec<Cycle<'_>> = of_cycle
                .map(|(cycle, blanks)| Cycle { blanks, spray: &cycle.spray[pixels.clone()] })
                .collect();
            band.add_cycles(level, &cycles).expect("cycles that sums could take");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::calibration::SakumaHattori;
    use crate::estimate::map::{CONFIDENCE, CameraNoise, Estimator, FitInputs, LookMap, look_at, look_into};

    const ROWS: usize = 13;
    /// So many that a band has four rows.
    const COLUMNS: usize = 1300;
    const PLATES_K: [f64; 5] = [373.0, 403.0, 433.0, 498.0, 533.0];
    const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

    fn inputs(estimator: Estimator, flat_gain: Option<&[f64]>) -> FitInputs<'_> {
        FitInputs {
            x_counts: PLATES_K.iter().map(|&t| Some(0.95 * CURVE.value(t))).collect(),
            gamma_near: 0.95,
            gamma_far: 0.95,
            emissivity_plate: 0.99,
            far_window_counts: 0.0,
            curve: CURVE,
            residual: None,
            range: None,
            camera: CameraNoise { read_noise_counts: 1.2, electrons_per_count: 500.0, zero_counts: 1500.0 },
            estimator,
            confidence: CONFIDENCE,
            flat_gain,
        }
    }

    /// Blanks and the spray frame of a cycle.
    type Frames = (Vec<Vec<u16>>, Vec<u16>);

    /// Those of every cycle and level, with pixels that are saturated, still or blind.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
    fn frames(cycles: usize, blanks: usize) -> Vec<Vec<Frames>> {
        let mut state = 7_u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            f64::from(u32::try_from(state >> 40).unwrap()) / 16_777_216.0 - 0.5
        };
        let pixels = ROWS * COLUMNS;
        let mut frame = |x: f64, depth: f64| -> Vec<u16> {
            let sees = |i: usize| if i / COLUMNS % 5 == 4 { 0.2 } else { 0.95 };
            let each = (0..pixels).map(|i| {
                let shot = depth * f64::from(u32::try_from(i % COLUMNS).unwrap()) * (1.0 + 0.3 * noise());
                1500.0 + sees(i) * (x + shot * (60.0 - x)) + 4.0 * noise()
            });
            let mut out: Vec<u16> = each.map(|count| count.round() as u16).collect();
            (out[30], out[40], out[9000]) = (16_383, 1700, 1700);
            out
        };
        let level = |plate: &f64| {
            let x = 0.95 * CURVE.value(*plate);
            let cycle = |_| ((0..blanks).map(|_| frame(x, 0.0)).collect(), frame(x, 1.0 / 1400.0));
            (0..cycles).map(cycle).collect()
        };
        PLATES_K.iter().map(level).collect()
    }

    fn bits(map: &LookMap) -> Vec<u32> {
        let channels = [
            &map.emissivity,
            &map.temperature_k,
            &map.sigma_emissivity,
            &map.sigma_temperature_k,
            &map.temperature_low_k,
            &map.temperature_high_k,
            &map.gain,
        ];
        let numbers = channels.into_iter().flatten().map(|v| v.to_bits());
        numbers.chain(map.flags.iter().copied()).collect()
    }

    /// Bands of rows give the bits of sums of the whole image: for every estimator, with and without gains, with one cycle a
    /// level (whose residuals are pooled), some blanks, and on any number of threads.
    #[test]
    fn bands_are_the_whole_image() {
        let flat: Vec<f64> = (0..ROWS * COLUMNS)
            .map(|i| if i % 97 == 3 { f64::NAN } else { 1.0 + (i % 7) as f64 * 0.01 })
            .collect();
        for (cycles, blanks, saturation) in [(3, 1, 16_383), (1, 1, 16_383), (2, 2, 60_000)] {
            let frames = frames(cycles, blanks);
            let of_level: Vec<Vec<Vec<&[u16]>>> = frames
                .iter()
                .map(|level| {
                    level.iter().map(|(blanks, _)| blanks.iter().map(Vec::as_slice).collect()).collect()
                })
                .collect();
            let levels: Vec<Vec<Cycle<'_>>> = frames
                .iter()
                .zip(&of_level)
                .map(|(level, blanks)| {
                    let each = level.iter().zip(blanks);
                    each.map(|((_, spray), blanks)| Cycle { blanks, spray }).collect()
                })
                .collect();
            let blanks = u16::try_from(blanks).unwrap();
            let like = Sums::new(PLATES_K.len(), ROWS, COLUMNS, blanks, saturation).unwrap();
            let shots = Shots::new(&like, levels.clone()).unwrap();
            assert!((2..ROWS / 2).contains(&shots.band_rows()));
            let mut sums = like.clone();
            for (level, cycles) in levels.iter().enumerate() {
                cycles.iter().for_each(|cycle| sums.add_cycle(level, cycle.blanks, cycle.spray).unwrap());
            }
            for estimator in [Estimator::Default, Estimator::Paper, Estimator::Ols] {
                for flat in [None, Some(flat.as_slice())] {
                    let inputs = inputs(estimator, flat);
                    let mut whole = LookMap::empty();
                    look_into(&sums, &inputs, &mut whole);
                    assert!(
                        whole.temperature_k.iter().filter(|t| t.is_finite()).count() > ROWS * COLUMNS / 2
                    );
                    for threads in [1, 3] {
                        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                        let mut bands = LookMap::empty();
                        pool.install(|| look_at(&shots, &inputs, &mut bands)).unwrap();
                        assert!(bits(&bands) == bits(&whole), "{cycles} {estimator:?} {threads}");
                    }
                }
            }
        }
    }

    #[test]
    fn shots_that_sums_would_refuse_are_refused() {
        let like = Sums::new(2, 1, 3, 1, 16_383).unwrap();
        let (frame, short) = ([1, 2, 3], [1, 2]);
        let good = Cycle { blanks: &[&frame], spray: &frame };
        assert!(Shots::new(&like, vec![vec![good], vec![]]).is_ok());
        assert!(Shots::new(&like, vec![vec![good]]).is_err());
        assert!(Shots::new(&like, vec![vec![Cycle { blanks: &[], ..good }], vec![]]).is_err());
        assert!(Shots::new(&like, vec![vec![Cycle { spray: &short, ..good }], vec![]]).is_err());
    }
}
