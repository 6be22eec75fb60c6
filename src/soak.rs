//! Decides when the plate is really settled.
//!
//! Settled means: in the band for the whole hold time, and slower than the slope limit over it, and with fresh
//! readings. The first touch of the set-point never counts (overshoot), a frozen display never counts. Pure.

use crate::config::Soak;
use std::collections::VecDeque;

/// What the judge says after a reading.
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// All conditions hold.
    Settled,
    /// Not yet: the reason in words and, when it can be guessed, the remaining time in s.
    Waiting {
        /// What is missing, with numbers.
        reason: String,
        /// Estimated remaining time in s.
        eta_s: Option<f64>,
    },
    /// The time-out has passed without settling.
    GivenUp {
        /// What was missing at the end.
        reason: String,
        /// Estimated remaining time in s, when it can be guessed.
        eta_s: Option<f64>,
    },
}

/// Judges the readings of one level.
#[derive(Debug)]
pub struct Judge {
    target_k: f64,
    rules: Soak,
    window: VecDeque<(f64, f64)>,
    begun_s: Option<f64>,
    changed_s: Option<f64>,
    last_k: Option<f64>,
}

impl Judge {
    /// A judge for one set-point in K.
    pub fn new(target_k: f64, rules: &Soak) -> Self {
        Self {
            target_k,
            rules: rules.clone(),
            window: VecDeque::new(),
            begun_s: None,
            changed_s: None,
            last_k: None,
        }
    }

    /// Takes the reading `value_k` of time `now_s` (s, any zero, not decreasing).
    pub fn push(&mut self, now_s: f64, value_k: f64) -> Verdict {
        let begun = *self.begun_s.get_or_insert(now_s);
        if !value_k.is_finite() {
            self.window.clear();
            return self.waiting(now_s - begun, "the reading is not a number".to_owned(), None);
        }
        // Identical bits: the display froze. A live display of 1 mK shows some noise within seconds.
        if self.last_k.is_none_or(|last| last.to_bits() != value_k.to_bits()) {
            self.changed_s = Some(now_s);
        }
        self.last_k = Some(value_k);
        self.window.push_back((now_s, value_k));
        while self.window.len() > 1 && self.window[1].0 <= now_s - self.rules.hold_s {
            self.window.pop_front();
        }
        let frozen_s = now_s - self.changed_s.unwrap_or(now_s);
        if frozen_s > self.rules.stale_s {
            let reason =
                format!("the reading has been exactly {value_k:.3} K for {frozen_s:.0} s: not fresh");
            return self.waiting(now_s - begun, reason, None);
        }
        let low = self.target_k - self.rules.band_k;
        let high = self.target_k + self.rules.band_k;
        let slope = self.slope_k_per_s();
        if value_k < low || value_k > high {
            self.restart_window(now_s, value_k);
            let reason = format!(
                "{value_k:.2} K, band {:.2} ± {:.2} K, drifting {:+.2} K/min",
                self.target_k,
                self.rules.band_k,
                slope * 60.0
            );
            let towards = (self.target_k - value_k) * slope > 0.0;
            let eta = towards.then(|| (self.target_k - value_k) / slope + self.rules.hold_s);
            return self.waiting(now_s - begun, reason, eta);
        }
        self.drop_before_band(low, high);
        let held = now_s - self.window.front().map_or(now_s, |first| first.0);
        // Half a poll of slack: the window is made of readings, not of instants.
        if held < self.rules.hold_s - 0.5 * self.rules.poll_s {
            let left = self.rules.hold_s - held;
            let reason = format!("{value_k:.2} K in band, held {held:.0} of {:.0} s", self.rules.hold_s);
            return self.waiting(now_s - begun, reason, Some(left));
        }
        let per_minute = (self.slope_k_per_s() * 60.0).abs();
        if per_minute > self.rules.slope_limit_k_per_min {
            let reason = format!(
                "{value_k:.2} K in band, but drifting {per_minute:.3} K/min, limit {:.3} K/min",
                self.rules.slope_limit_k_per_min
            );
            return self.waiting(now_s - begun, reason, None);
        }
        Verdict::Settled
    }

    fn waiting(&self, since_s: f64, reason: String, eta_s: Option<f64>) -> Verdict {
        if since_s > self.rules.timeout_s {
            Verdict::GivenUp { reason, eta_s }
        } else {
            Verdict::Waiting { reason, eta_s }
        }
    }

    /// Outside the band nothing counts towards the hold time, but a few readings are kept for the slope.
    fn restart_window(&mut self, now_s: f64, value_k: f64) {
        let keep_from = now_s - 10.0 * self.rules.poll_s;
        self.window.retain(|(t, _)| *t >= keep_from);
        if self.window.is_empty() {
            self.window.push_back((now_s, value_k));
        }
    }

    fn drop_before_band(&mut self, low: f64, high: f64) {
        if let Some(last_outside) = self.window.iter().rposition(|(_, k)| *k < low || *k > high) {
            self.window.drain(..=last_outside);
        }
    }

    /// Least-squares slope over the window, in K/s; zero with fewer than two readings.
    fn slope_k_per_s(&self) -> f64 {
        let n = self.window.len() as f64;
        if self.window.len() < 2 {
            return 0.0;
        }
        let mean_t = self.window.iter().map(|(t, _)| t).sum::<f64>() / n;
        let mean_k = self.window.iter().map(|(_, k)| k).sum::<f64>() / n;
        let (mut num, mut den) = (0.0, 0.0);
        for (t, k) in &self.window {
            num += (t - mean_t) * (k - mean_k);
            den += (t - mean_t) * (t - mean_t);
        }
        if den > 0.0 { num / den } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules() -> Soak {
        Soak {
            band_k: 0.3,
            hold_s: 60.0,
            slope_limit_k_per_min: 0.1,
            poll_s: 1.0,
            stale_s: 20.0,
            timeout_s: 3600.0,
        }
    }

    /// Time at which a judge first says settled for readings of `plate(t)`; `None` when it gives up.
    fn settled_at(plate: impl Fn(f64) -> f64) -> Option<f64> {
        let mut judge = Judge::new(400.0, &rules());
        for second in 0..4000u32 {
            let t = f64::from(second);
            match judge.push(t, plate(t)) {
                Verdict::Settled => return Some(t),
                Verdict::GivenUp { .. } => return None,
                Verdict::Waiting { .. } => {}
            }
        }
        None
    }

    fn noise(t: f64) -> f64 {
        0.002 * (t * 12.9898).sin()
    }

    #[test]
    fn the_first_touch_of_the_set_point_does_not_count() {
        // Crosses the set-point at 100 s with 0.5 K/s, overshoots by 5 K, comes back.
        let plate = |t: f64| {
            let arrive = (t / 200.0).min(1.0);
            let overshoot = if t > 200.0 { 5.0 * (-(t - 200.0) / 120.0).exp() } else { 5.0 * arrive };
            300.0 + 100.0 * arrive + overshoot + noise(t)
        };
        let at = settled_at(plate).expect("it settles in the end");
        // 5 K · exp(−t/120 s) falls below 0.3 K after 338 s, below 0.1 K/min · after 385 s; hold adds 60 s.
        assert!(at > 538.0 + 59.0, "settled at {at} s");
    }

    #[test]
    fn a_slow_drift_inside_the_band_does_not_settle() {
        // 0.15 K/min for four minutes inside the band, then out of it for good.
        assert_eq!(settled_at(|t| 399.72 + 0.15 / 60.0 * t + noise(t)), None);
    }

    #[test]
    fn a_frozen_reading_does_not_settle() {
        assert_eq!(settled_at(|_| 400.0), None);
    }

    #[test]
    fn a_reading_that_is_not_a_number_restarts_the_hold_time() {
        let at = settled_at(|t| if (t - 50.0).abs() < 0.5 { f64::NAN } else { 400.0 + noise(t) })
            .expect("settles");
        assert!(at >= 110.0, "settled at {at} s");
    }

    #[test]
    fn a_quiet_plate_settles_after_the_hold_time() {
        let at = settled_at(|t| 400.05 + noise(t)).expect("settles");
        assert!((59.0..=62.0).contains(&at), "settled at {at} s");
    }
}
