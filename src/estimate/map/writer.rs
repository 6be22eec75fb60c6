//! Fits a row of pixels: vectors of them, then the few that go alone, then temperatures. Answers go straight to where
//! they stay: a copy of fifteen channels costs a tenth of a solve.

use super::ahead;
use super::answers::{Answers, Channels};
use super::kernel::{self, ALONE, Everywhere, GAIN, Ground, Group, Level, Scratch};
use super::lanes::{Lanes, Machine, Number, WIDEST};
use super::levels::{Any, Known, Levels};
use super::lines::{self, Credible};
use super::rows::Row;
use super::single::Pixel;
use super::solver::Common;
use super::thermometer::Thermometer;
use super::ways::{self, Way};
use super::{CHANNELS, Estimator, flag};
use crate::estimate::student::NODES;
use pulp::Simd;
use std::marker::PhantomData;

/// Where `sigma_t_noise_k` stands among the channels.
const NOISE: usize = 12;

/// Memory and constants for the rows of a band that go into a map of the kind `M`.
pub(super) struct Writer<'a, F, M> {
    common: &'a Common<'a>,
    thermometer: Thermometer<'a, F>,
    flags: Vec<F>,
    pixel: Pixel,
    map: PhantomData<M>,
}

impl<'a, F: Machine, M: Answers<F>> Writer<'a, F, M> {
    pub(super) fn new(common: &'a Common<'a>, stride: usize) -> Self {
        Self {
            common,
            thermometer: Thermometer::new(common.inputs),
            flags: vec![F::of(0.0); stride],
            pixel: Pixel::default(),
            map: PhantomData,
        }
    }

    /// Fits a row.
    #[inline(always)]
    pub(super) fn row<S: Simd>(
        &mut self,
        simd: S,
        row: &Row<'_, F>,
        mut channels: Channels<'_, F>,
        bits: &mut [u32],
    ) {
        match self.common.inputs.estimator {
            Estimator::Default => self.fit::<S, ways::Ours>(simd, row, &mut channels),
            Estimator::Paper => self.fit::<S, ways::Papers>(simd, row, &mut channels),
            Estimator::Ols => self.fit::<S, ways::Unweighted>(simd, row, &mut channels),
        }
        for (bits, flags) in bits.iter_mut().zip(&self.flags) {
            *bits = flags.bits_of();
        }
        self.alone(row, &mut channels, bits);
        let [_, _, _, _, temperature, _, sigma, _, _, _, low, high, noise, _, _] = channels;
        if M::WANTED[NOISE] {
            self.thermometer.read_flagged(temperature, [sigma, noise], bits);
        } else {
            self.thermometer.read_flagged(temperature, [sigma], bits);
        }
        self.thermometer.read(low);
        self.thermometer.read(high);
    }

    #[inline(always)]
    fn fit<S: Simd, W: Way>(&mut self, simd: S, row: &Row<'_, F>, channels: &mut Channels<'_, F>) {
        match self.common.used.len() {
            2 => self.vectors::<S, W, Known<2>>(simd, row, channels),
            3 => self.vectors::<S, W, Known<3>>(simd, row, channels),
            4 => self.vectors::<S, W, Known<4>>(simd, row, channels),
            5 => self.vectors::<S, W, Known<5>>(simd, row, channels),
            6 => self.vectors::<S, W, Known<6>>(simd, row, channels),
            _ => self.vectors::<S, W, Any>(simd, row, channels),
        }
    }

    #[inline(always)]
    fn vectors<S: Simd, W: Way, L: Levels>(
        &mut self,
        simd: S,
        row: &Row<'_, F>,
        channels: &mut Channels<'_, F>,
    ) {
        // A function of its own for every estimator and number of levels, or all would have to share registers.
        simd.vectorize(Vectors::<F, M, W, L> {
            common: self.common,
            row,
            channels,
            flags: &mut self.flags,
            kind: PhantomData,
        });
    }

    /// Pixels that were marked, one by one.
    fn alone(&mut self, row: &Row<'_, F>, channels: &mut Channels<'_, F>, bits: &mut [u32]) {
        if bits.iter().fold(0, |any, bits| any | bits) & ALONE == 0 {
            return;
        }
        let common = self.common;
        for (i, bits) in bits.iter_mut().enumerate() {
            if *bits & ALONE == 0 {
                continue;
            }
            *bits = row.flags[i].bits_of();
            let residuals = common.residuals.at(row.row * row.columns + i);
            self.pixel.gather(row, i, common.inputs, &common.constants, residuals);
            let answer = self.pixel.fit(&common.constants);
            for (at, channel) in channels[..GAIN].iter_mut().enumerate() {
                if let Some(channel) = channel.get_mut(i) {
                    *channel = answer.as_ref().map_or(F::NAN, |answer| F::of(answer.channels[at].1));
                }
            }
            *bits |= answer.map_or(flag::TOO_FEW_LEVELS, |answer| answer.flags.1.bits_of());
        }
    }
}

/// A row's vectors, fitted for `L` levels.
struct Vectors<'r, 'c, F, M, W, L> {
    common: &'r Common<'r>,
    row: &'r Row<'r, F>,
    channels: &'r mut Channels<'c, F>,
    flags: &'r mut [F],
    kind: PhantomData<(M, W, L)>,
}

impl<F: Machine, M: Answers<F>, W: Way, L: Levels> pulp::WithSimd for Vectors<'_, '_, F, M, W, L> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { common, row, channels, flags, .. } = self;
        let constants = &common.constants;
        let (levels, width) = (L::number(constants.x.len()), F::width::<S>());
        let each = row.stride / width;
        let one = F::read(simd, row.flat, 0).all(0.0);
        let mut powers = [one; NODES];
        for (to, &power) in powers.iter_mut().zip(&constants.quantile) {
            *to = one.all(power);
        }
        let powers = &powers[..constants.quantile.len().min(NODES)];
        let mut places = lines::places::<_, L>(one, &constants.x);
        let mut plain = lines::place(one, &constants.x, places.as_mut());
        let everywhere = Everywhere::new(one, constants);
        let mut credible = Credible::of(one, places.as_ref());
        let mut scratch = Scratch::<_, L>::new(one, levels);
        let mut last = [[F::of(0.0); WIDEST]; CHANNELS.len()];
        for vector in 0..row.columns.div_ceil(width) {
            row.ahead.fetch(vector * width);
            if vector == 0 || !row.alike {
                for (k, place) in places.as_mut().iter_mut().enumerate() {
                    place.count = F::read(simd, row.count, k * each + vector);
                }
                plain = lines::place(one, &constants.x, places.as_mut());
                credible = Credible::of(one, places.as_ref());
            }
            for (k, level) in scratch.levels.as_mut().iter_mut().enumerate() {
                let at = k * each + vector;
                *level = Level {
                    mean: F::read(simd, row.mean, at),
                    squares: F::read(simd, row.squares, at),
                    blank: F::read(simd, row.blank, at),
                    pooled: F::read(simd, row.pooled, at),
                };
            }
            let group = Group {
                flat: F::read(simd, row.flat, vector),
                even: row.even,
                flags: F::read(simd, row.flags, vector),
                alive: F::read(simd, row.alive, vector),
                first_mean: one,
                singles: row.singles,
                alike: row.alike,
            };
            let ground =
                Ground { one, constants: everywhere, places: places.as_ref(), plain, credible, powers };
            let answer = kernel::fit::<_, W, _>(&ground, group, &mut scratch);
            let to = vector * width..(vector + 1) * width;
            F::write::<S>(&mut flags[to.clone()], answer.flags);
            // The last pixels of a row may be fewer than a vector holds.
            let complete = to.end <= row.columns;
            macro_rules! write {
                // Spelled out: a loop over vectors would take them through the stack.
                ($($channel:literal)*) => {$(
                    if M::WANTED[$channel] {
                        ahead::room(channels[$channel], to.start);
                        let numbers =
                            if complete { &mut channels[$channel][to.clone()] } else { &mut last[$channel][..width] };
                        F::write::<S>(numbers, answer.channels[$channel]);
                    }
                )*};
            }
            write!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14);
            if !complete {
                for (channel, last) in channels.iter_mut().zip(&last) {
                    if let Some(end) = channel.get_mut(to.start..) {
                        end.copy_from_slice(&last[..end.len()]);
                    }
                }
            }
        }
    }
}
