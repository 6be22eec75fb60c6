//! One jet along its axis: fuel, entrained gas, droplets and vapour, from the start of injection on.
//!
//! Musculus and Kattke 2009 (SAE 2009-01-1355), the unsteady form of Naber and Siebers' 1996 control volume: the jet is
//! cut into sections of a given area A(s); fuel and its momentum move with v = β ū, gas is entrained so that a section
//! stays full. Both are injected in the ratio U and move alike, so that momentum/fuel = U everywhere and the mean
//! velocity is U q, q = f/(f + m) with the masses f of fuel and m of gas. What is left is one conservation law,
//! ∂f/∂t + ∂(v f)/∂s = 0, in upwind form; after the end of injection the entrainment wave follows by itself.
//!
//! Across, the fuel has Abramovich's profile (see `profile`). A section is cut into tubes that hold fixed shares of its
//! fuel, from the middle outwards; the profile tells how much gas a tube has. Droplets, heat and vapour of a tube stay
//! in it (no exchange but by what the profile entrains), its gas temperature follows from adiabatic mixing: the
//! enthalpy of its fuel and gas is the one that they came with.
//!
//! Left out: slip between droplets and jet (but for the wind that evaporates them), the cooled gas's contraction (at
//! most a quarter of the volume), condensation, the interaction of plumes.

use super::droplet::{Around, rates, surface};
use super::profile::{Across, Profile};
use super::properties::Properties;
use super::sizes::{Class, sphere_kg};
use rayon::prelude::*;

/// Shares of a section's fuel within which each tube ends; fine at the edge, where vapour and temperature change most.
const TUBES: [f64; 11] = [0.0, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96, 0.99, 1.0];
/// Sections up to the expected tip. Twice as many, with half the step of the evaporation, change the evaporated share by
/// 0.2 points and the tip by 0.1 mm (Spray G at 0.5 ms).
const SECTIONS: usize = 120;
/// Sections at most: the jet may get beyond the expected tip.
const SECTIONS_MAX: usize = 4 * SECTIONS;
/// Courant number of the upwind step.
const COURANT: f64 = 0.8;
/// Least step of the evaporation, s.
const EVAPORATION_S: f64 = 4e-6;
/// Most steps of the evaporation: droplets live for a tenth of a spray's age or longer, or are gone soon after the nozzle.
const EVAPORATIONS: f64 = 400.0;
/// Steps at most; a jet that needs more is refused.
const STEPS_MAX: usize = 200_000;
/// Droplets of a smaller share of their initial mass are gone: 1e-6 is a hundredth of the diameter.
const GONE: f64 = 1e-6;
/// Share of the injected fuel in the last section at which another one is added.
const TRACE: f64 = 1e-10;
/// Speed of droplets relative to their gas over the jet's mean speed: the turbulence intensity on the axis of a round
/// jet is 0.25 (Pope 2000, Turbulent Flows, §5.1). Droplets of 10 µm evaporate 20 % faster by it.
const SLIP: f64 = 0.25;

/// How the cross-section grows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Opening {
    /// A cone about the axis.
    Round {
        /// Radius at the nozzle, m.
        radius_m: f64,
        /// Tangent of the half angle.
        growth: f64,
    },
    /// A conical sheet; s runs along it.
    Sheet {
        /// Radius of the ring that it leaves from, m.
        ring_m: f64,
        /// Sine of the cone's half angle.
        sine: f64,
        /// Half thickness at the nozzle, m.
        half_m: f64,
        /// Tangent of the half angle by which the sheet spreads.
        growth: f64,
    },
}

impl Opening {
    /// Radius of a round jet, half thickness of a sheet, in m, at `s` m from the nozzle.
    pub(super) fn half_m(&self, s: f64) -> f64 {
        match *self {
            Self::Round { radius_m, growth } => radius_m + growth * s,
            Self::Sheet { half_m, growth, .. } => half_m + growth * s,
        }
    }

    /// Cross-section in m².
    pub(super) fn area_m2(&self, s: f64) -> f64 {
        let half = self.half_m(s);
        match *self {
            Self::Round { .. } => std::f64::consts::PI * half * half,
            Self::Sheet { ring_m, sine, .. } => 4.0 * std::f64::consts::PI * (ring_m + sine * s) * half,
        }
    }

    pub(super) fn across(&self) -> Across {
        match self {
            Self::Round { .. } => Across::Disc,
            Self::Sheet { .. } => Across::Sheet,
        }
    }
}

/// What a jet starts from.
#[derive(Debug, Clone)]
pub(super) struct Start {
    pub(super) opening: Opening,
    /// Exit velocity, m/s.
    pub(super) velocity_m_s: f64,
    /// Mass flow, kg/s.
    pub(super) flow_kg_s: f64,
    /// End of injection, s.
    pub(super) duration_s: f64,
    /// Temperatures of fuel and gas, K.
    pub(super) fuel_k: f64,
    pub(super) gas_k: f64,
    /// Sizes of the droplets at the nozzle.
    pub(super) classes: Vec<Class>,
}

/// Droplets of one class in a tube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Drops {
    /// Liquid over the liquid that was injected, 0 … 1.
    pub(super) left: f64,
    /// Temperature, K.
    pub(super) temperature_k: f64,
}

/// A part of a section.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tube {
    /// Per class.
    pub(super) drops: Vec<Drops>,
    /// Temperature of gas and vapour, K.
    pub(super) gas_k: f64,
    /// Gas over fuel, by mass.
    pub(super) gas_ratio: f64,
}

impl Tube {
    /// Vapour over fuel, by mass.
    pub(super) fn vapour(&self, classes: &[Class]) -> f64 {
        self.drops.iter().zip(classes).map(|(d, c)| c.share * (1.0 - d.left)).sum()
    }
}

/// A slice of the jet.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Section {
    /// Fuel, kg.
    pub(super) fuel_kg: f64,
    /// Mean velocity over the exit velocity.
    pub(super) slowness: f64,
    /// From the middle outwards.
    pub(super) tubes: Vec<Tube>,
}

/// A jet at one time.
#[derive(Debug, Clone)]
pub(super) struct Jet {
    pub(super) start: Start,
    /// Thickness of a section, m; section i is from i to i + 1 of them.
    pub(super) step_m: f64,
    pub(super) sections: Vec<Section>,
    /// Density of the gas far away and of the liquid at the nozzle, kg/m³.
    gas_kg_m3: f64,
    liquid_kg_m3: f64,
}

impl Jet {
    /// The jet `time_s` after the start of injection.
    ///
    /// # Errors
    ///
    /// In words, when it would take more steps or sections than the limits.
    pub(super) fn at(start: Start, properties: &Properties, time_s: f64) -> Result<Self, String> {
        let gas_kg_m3 = properties.mixture_kg_m3(start.gas_k, 0.0);
        let liquid_kg_m3 = properties.at(start.fuel_k).liquid_kg_m3;
        let mut jet = Self { start, step_m: 0.0, sections: Vec::new(), gas_kg_m3, liquid_kg_m3 };
        jet.step_m = jet.steady_tip_m(time_s) / SECTIONS as f64;
        let mut now_s = 0.0;
        let mut since_s = 0.0;
        for _ in 0..STEPS_MAX {
            if now_s >= time_s {
                return Ok(jet);
            }
            let fastest = jet.sections.iter().map(|s| jet.speed(s)).fold(0.0, f64::max);
            let inflow = if now_s < jet.start.duration_s { jet.start.velocity_m_s } else { 0.0 };
            let mut step_s = (COURANT * jet.step_m / fastest.max(inflow).max(1e-3)).min(time_s - now_s);
            if now_s < jet.start.duration_s {
                step_s = step_s.min(jet.start.duration_s - now_s);
            }
            jet.advect(step_s, inflow > 0.0)?;
            now_s += step_s;
            since_s += step_s;
            // Splitting: flow first, then the same time of evaporation.
            if since_s >= EVAPORATION_S.max(time_s / EVAPORATIONS) || now_s >= time_s {
                jet.mix_gas(properties);
                jet.evaporate(since_s, properties);
                since_s = 0.0;
            }
        }
        Err(format!("the jet needs more than {STEPS_MAX} steps"))
    }

    /// Density of the liquid at the nozzle, kg/m³.
    pub(super) fn liquid_kg_m3(&self) -> f64 {
        self.liquid_kg_m3
    }

    /// Mass of all fuel, kg.
    pub(super) fn fuel_kg(&self) -> f64 {
        self.sections.iter().map(|s| s.fuel_kg).sum()
    }

    /// Distance in m along the axis within which a share of the fuel is; 0 without fuel.
    pub(super) fn within_m(&self, share: f64) -> f64 {
        let wanted = share * self.fuel_kg();
        let mut sum = 0.0;
        for (i, section) in self.sections.iter().enumerate() {
            if section.fuel_kg > 0.0 && sum + section.fuel_kg >= wanted {
                return self.step_m * (i as f64 + (wanted - sum) / section.fuel_kg);
            }
            sum += section.fuel_kg;
        }
        self.step_m * self.sections.len() as f64
    }

    /// The profile of a section.
    pub(super) fn profile(&self, section: &Section) -> Profile {
        self.start.opening.across().with_mean(section.slowness)
    }

    /// Shares of the fuel at which tube `tube` begins and ends.
    pub(super) fn tube_shares(tube: usize) -> [f64; 2] {
        [TUBES[tube], TUBES[tube + 1]]
    }

    fn volume_m3(&self, section: usize) -> f64 {
        let at = |part: f64| self.start.opening.area_m2(self.step_m * (section as f64 + part));
        // Simpson's rule is exact for these areas.
        self.step_m * (at(0.0) + 4.0 * at(0.5) + at(1.0)) / 6.0
    }

    fn slowness(&self, section: usize, fuel_kg: f64) -> f64 {
        let gas_kg = self.gas_kg_m3 * (self.volume_m3(section) - fuel_kg / self.liquid_kg_m3).max(0.0);
        if fuel_kg > 0.0 { fuel_kg / (fuel_kg + gas_kg) } else { 0.0 }
    }

    /// Speed of the fuel, m/s.
    fn speed(&self, section: &Section) -> f64 {
        self.profile(section).beta() * self.start.velocity_m_s * section.slowness
    }

    /// Where the tip of a steady jet would be, m: the scale of the sections.
    fn steady_tip_m(&self, time_s: f64) -> f64 {
        let steps = 400;
        let (mut tip_m, step_s) = (0.0, time_s / f64::from(steps));
        let momentum = self.start.flow_kg_s * self.start.velocity_m_s;
        for _ in 0..steps {
            // β ū of the developed jet from its momentum, never faster than the nozzle.
            let beta = self.start.opening.across().with_mean(0.0).beta();
            let area = self.start.opening.area_m2(tip_m);
            let speed = (beta * momentum / (self.gas_kg_m3 * area)).sqrt().min(self.start.velocity_m_s);
            tip_m += speed * step_s;
        }
        tip_m
    }

    fn empty(&self) -> Section {
        let drops = vec![Drops { left: 1.0, temperature_k: self.start.fuel_k }; self.start.classes.len()];
        let tube = Tube { drops, gas_k: self.start.gas_k, gas_ratio: f64::INFINITY };
        Section { fuel_kg: 0.0, slowness: 0.0, tubes: vec![tube; TUBES.len() - 1] }
    }

    /// One upwind step of fuel, liquid and its heat; `injecting` feeds the first section.
    fn advect(&mut self, step_s: f64, injecting: bool) -> Result<(), String> {
        let trace_kg = TRACE * self.start.flow_kg_s * self.start.duration_s;
        if self.sections.last().is_none_or(|s| s.fuel_kg > trace_kg) {
            if self.sections.len() >= SECTIONS_MAX {
                return Err("the jet gets further than expected".to_owned());
            }
            let empty = self.empty();
            self.sections.push(empty);
        }
        // What leaves each section; the last one keeps its trace.
        let mut moved: Vec<f64> = self
            .sections
            .iter()
            .map(|s| s.fuel_kg * (self.speed(s) * step_s / self.step_m).min(1.0))
            .collect();
        moved.pop();
        moved.push(0.0);
        for i in (0..self.sections.len()).rev() {
            let entering = match i {
                0 if injecting => self.start.flow_kg_s * step_s,
                0 => 0.0,
                _ => moved[i - 1],
            };
            let stays = self.sections[i].fuel_kg - moved[i];
            let fuel_kg = stays + entering;
            let fresh = self.empty();
            let (before, rest) = self.sections.split_at_mut(i);
            let from = before.last().unwrap_or(&fresh);
            let section = &mut rest[0];
            if entering > 0.0 {
                for (tube, source) in section.tubes.iter_mut().zip(&from.tubes) {
                    for (own, new) in tube.drops.iter_mut().zip(&source.drops) {
                        *own = mix(*own, stays / fuel_kg, *new, entering / fuel_kg);
                    }
                }
            }
            section.fuel_kg = fuel_kg;
            let slowness = self.slowness(i, fuel_kg);
            self.sections[i].slowness = slowness;
        }
        Ok(())
    }

    /// Gas of every tube from the profile, and its temperature.
    fn mix_gas(&mut self, properties: &Properties) {
        let sections = std::mem::take(&mut self.sections);
        let mixed = sections
            .into_iter()
            .enumerate()
            .map(|(i, mut section)| {
                if section.fuel_kg > 0.0 {
                    let profile = self.profile(&section);
                    let filling = section.fuel_kg / (self.liquid_kg_m3 * self.volume_m3(i));
                    let mut inner = 0.0;
                    for (j, tube) in section.tubes.iter_mut().enumerate() {
                        let [from, to] = Self::tube_shares(j);
                        let outer = profile.area(profile.eta(to));
                        // Volume fraction of fuel in this tube.
                        let fraction = (filling * (to - from) / (outer - inner).max(1e-12)).min(1.0);
                        tube.gas_ratio = self.gas_kg_m3 / self.liquid_kg_m3 * (1.0 / fraction - 1.0);
                        inner = outer;
                        tube.gas_k = self.gas_temperature_k(tube, properties);
                    }
                }
                section
            })
            .collect();
        self.sections = mixed;
    }

    /// Temperature of a tube's gas from the enthalpy that fuel and gas came with.
    fn gas_temperature_k(&self, tube: &Tube, properties: &Properties) -> f64 {
        let Start { gas_k, fuel_k, ref classes, .. } = self.start;
        let liquid: f64 = tube
            .drops
            .iter()
            .zip(classes)
            .map(|(d, c)| c.share * d.left * properties.at(d.temperature_k).liquid_j_kg)
            .sum();
        let vapour = tube.vapour(classes);
        let available = tube.gas_ratio * properties.at(gas_k).gas_j_kg - liquid;
        let mut guess = tube.gas_k;
        // Both enthalpies are nearly straight: Newton's steps halve the error's digits; bounded by what can be.
        for _ in 0..4 {
            let at = properties.at(guess);
            let capacity = tube.gas_ratio * at.gas_j_kg_k + vapour * at.vapour_j_kg_k;
            if capacity <= 0.0 {
                return fuel_k;
            }
            let excess = available - tube.gas_ratio * at.gas_j_kg - vapour * at.vapour_j_kg;
            guess = (guess + excess / capacity).clamp(200.0, gas_k.max(fuel_k));
        }
        guess
    }

    /// Evaporates and warms all droplets for a time.
    fn evaporate(&mut self, step_s: f64, properties: &Properties) {
        let mut sections = std::mem::take(&mut self.sections);
        let jet = &*self;
        sections.par_iter_mut().filter(|s| s.fuel_kg > 0.0).for_each(|section| {
            let slip_m_s = SLIP * jet.start.velocity_m_s * section.slowness;
            for tube in &mut section.tubes {
                jet.evaporate_tube(tube, slip_m_s, step_s, properties);
                tube.gas_k = jet.gas_temperature_k(tube, properties);
            }
        });
        self.sections = sections;
    }

    fn evaporate_tube(&self, tube: &mut Tube, slip_m_s: f64, step_s: f64, properties: &Properties) {
        let classes = &self.start.classes;
        let vapour = tube.vapour(classes);
        let moist = vapour / (vapour + tube.gas_ratio).max(1e-300);
        let around = Around { temperature_k: tube.gas_k, vapour: moist, slip_m_s };
        // Per kg of fuel: what would evaporate and what heat would flow if the gas stayed as it is.
        let (mut demand_kg, mut demand_j) = (0.0, 0.0);
        let (mut liquid, mut warmth) = (0.0, 0.0);
        let mut wanted = Vec::with_capacity(classes.len());
        for (drops, class) in tube.drops.iter().zip(classes) {
            if drops.left <= 0.0 {
                wanted.push(None);
                continue;
            }
            let density = properties.at(drops.temperature_k).liquid_kg_m3;
            let per_droplet = sphere_kg(class.diameter_m, self.liquid_kg_m3);
            let diameter_m = class.diameter_m * (drops.left * self.liquid_kg_m3 / density).cbrt();
            let now = rates(properties, diameter_m, drops.temperature_k, &around);
            let warmer = rates(properties, diameter_m, drops.temperature_k + 0.5, &around);
            let slope = ((warmer.warming_k_s - now.warming_k_s) / 0.5).min(0.0);
            // Exponential step: exact for a temperature that relaxes, stable for any step.
            let grown = relaxed(-slope * step_s) * step_s;
            // d² falls evenly: mass to the power 3/2.
            let shrunk = (1.0 - 2.0 / 3.0 * now.mass_kg_s * step_s / (per_droplet * drops.left)).max(0.0);
            let lost = drops.left * (1.0 - shrunk.powf(1.5));
            let warming = now.warming_k_s * grown;
            demand_kg += class.share * lost;
            demand_j += class.share
                * (drops.left * properties.at(drops.temperature_k).liquid_j_kg_k * warming
                    + lost * properties.at(drops.temperature_k).latent_j_kg());
            liquid += class.share * drops.left;
            warmth += class.share * drops.left * drops.temperature_k;
            wanted.push(Some((lost, warming)));
        }
        if liquid <= 0.0 {
            return;
        }
        let mean_k = warmth / liquid;
        // What saturates the gas, and the heat that brings gas and droplets to one temperature.
        let saturated = surface(properties, mean_k);
        let room_kg = (saturated / (1.0 - saturated) * tube.gas_ratio - vapour).max(0.0);
        let capacity = tube.gas_ratio * properties.at(tube.gas_k).gas_j_kg_k
            + vapour * properties.at(tube.gas_k).vapour_j_kg_k;
        let spare_j = (capacity * (tube.gas_k - mean_k)).abs();
        let evaporating = relaxed_by(demand_kg, room_kg);
        // Heat out of the droplets needs no gas: cooling by evaporation alone is bounded by the saturation.
        let heating =
            if demand_j * (tube.gas_k - mean_k) > 0.0 { relaxed_by(demand_j.abs(), spare_j) } else { 1.0 };
        let part = evaporating.min(heating);
        for (drops, wanted) in tube.drops.iter_mut().zip(wanted) {
            let Some((lost, warming)) = wanted else { continue };
            drops.left -= part * lost;
            // Gas warms droplets up to its own temperature, however steep the way there is for the smallest.
            let warmest =
                drops.temperature_k.max(tube.gas_k).min(properties.boiling_k.max(self.start.fuel_k));
            drops.temperature_k = (drops.temperature_k + part * warming).clamp(220.0, warmest.max(220.0));
            if drops.left < GONE {
                drops.left = 0.0;
            }
        }
    }
}

/// (1 − e^−x)/x: how much of an even step a relaxing value makes.
fn relaxed(x: f64) -> f64 {
    if x < 1e-6 { 1.0 } else { -(-x).exp_m1() / x }
}

/// The same for a demand that must not exceed a supply.
fn relaxed_by(demand: f64, supply: f64) -> f64 {
    if demand <= 0.0 {
        1.0
    } else if supply <= 0.0 {
        0.0
    } else {
        relaxed(demand / supply)
    }
}

/// Droplets of two origins as one; the temperature is weighted with the liquid.
fn mix(a: Drops, share_a: f64, b: Drops, share_b: f64) -> Drops {
    let (a_left, b_left) = (share_a * a.left, share_b * b.left);
    let left = a_left + b_left;
    let temperature_k = if left > 0.0 {
        (a_left * a.temperature_k + b_left * b.temperature_k) / left
    } else {
        share_a * a.temperature_k + share_b * b.temperature_k
    };
    Drops { left: left.min(1.0), temperature_k }
}
