//! The stable-at-set-point bit for controllers that have none of their own.

use crate::quantity::{Kelvin, KelvinDelta};
use std::time::Duration;
use tokio::time::Instant;

/// Time within the limit after which a plate is called stable: that of the Fluke 418x (Users Guide, 5.2.1.1.2), so that
/// the bit means the same whatever stands there.
const STABLE_AFTER: Duration = Duration::from_secs(60);

/// Longest time between readings over which nothing is assumed of what lies between.
const GAP_MAX: Duration = Duration::from_secs(30);

/// Watches readings.
#[derive(Debug, Default)]
pub(crate) struct Steadiness {
    within: Option<(Instant, Instant)>,
}

impl Steadiness {
    /// Takes a reading; true when all readings of the last minute lay within `limit` of the set-point.
    pub(crate) fn is_stable(&mut self, reading: Kelvin, set_point: Kelvin, limit: KelvinDelta) -> bool {
        let now = Instant::now();
        let is_within = (reading - set_point).abs() <= limit;
        self.within = match self.within {
            _ if !is_within => None,
            Some((since, last)) if now - last <= GAP_MAX => Some((since, now)),
            _ => Some((now, now)),
        };
        self.within.is_some_and(|(since, _)| now - since >= STABLE_AFTER)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::sleep;

    #[tokio::test(start_paused = true)]
    async fn stable_is_a_whole_minute_within_the_limit() {
        let mut steadiness = Steadiness::default();
        let mut judge = |kelvin: f64| steadiness.is_stable(Kelvin(kelvin), Kelvin(400.0), KelvinDelta(0.4));
        for second in 0..=60 {
            assert_eq!(judge(400.3), second == 60, "{second}");
            sleep(Duration::from_secs(1)).await;
        }
        assert!(!judge(400.5));
        assert!(!judge(400.0));
        sleep(Duration::from_secs(20)).await;
        assert!(!judge(400.0));
        // Nobody looked for two minutes.
        sleep(Duration::from_secs(120)).await;
        assert!(!judge(400.0));
        assert!(!judge(f64::NAN));
    }
}
