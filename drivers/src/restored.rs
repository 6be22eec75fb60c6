//! Brings a calibrator back to what it was told when its line was lost and opened again.
//!
//! A unit that was unplugged may have been switched off, or be another one. So the wrapper asks who it is, prepares it
//! (units, formats, limits, cutouts), sets the set-point that it was given last, and only then does what was asked. It also
//! notices a set-point that somebody else has changed. Drivers inside know nothing of it.

use crate::error::DriverError;
use crate::instrument::{Calibrator, CalibratorSettings, Identity, MonitorReading, PlateReading};
use crate::quantity::{Kelvin, KelvinDelta};
use async_trait::async_trait;

/// How often the line may be lost within one act.
const LOSSES_MAX: u32 = 3;

/// How far a set-point may lie from the one that was confirmed: one step of a Fluke 418x, whose steps are the finest.
const SET_POINT_TOLERANCE: KelvinDelta = KelvinDelta(0.011);

/// A calibrator that survives the loss of its line.
pub struct Restored<C> {
    inner: C,
    name: String,
    identity: Option<Identity>,
    settings: Option<CalibratorSettings>,
    /// Asked for, and taken.
    target: Option<(Kelvin, Kelvin)>,
    /// The line was lost: what the instrument holds is not known.
    forgotten: bool,
}

impl<C: Calibrator> Restored<C> {
    /// Wraps a driver; `name` says who it is at the start of messages.
    pub fn new(inner: C, name: impl Into<String>) -> Self {
        Self { inner, name: name.into(), identity: None, settings: None, target: None, forgotten: false }
    }

    /// Tells the instrument again what it must hold, if its line was lost.
    async fn restore(&mut self) -> Result<(), DriverError> {
        if !self.forgotten {
            return Ok(());
        }
        let identity = self.inner.identify().await?;
        if let Some(before) = &self.identity
            && (&before.model, &before.serial) != (&identity.model, &identity.serial)
        {
            return Err(self.refused(
                "asking who it is after its line was lost",
                format!(
                    "{} {} answers where {} {} did before",
                    identity.model, identity.serial, before.model, before.serial
                ),
                "Plug the right instrument in again, or start a new campaign.",
            ));
        }
        if let Some(settings) = &self.settings {
            self.inner.prepare(settings).await?;
        }
        if let Some((target, taken)) = self.target {
            let again = self.inner.set_point(target).await?;
            self.target = Some((target, again));
            if (again - taken).abs() > SET_POINT_TOLERANCE {
                let why = format!("it took {again:.3} where it had taken {taken:.3}");
                return Err(self.refused(
                    "setting the set-point again",
                    why,
                    "Check its resolution and units.",
                ));
            }
        }
        self.forgotten = false;
        Ok(())
    }

    /// Counts a loss; true when the act may be tried again.
    fn may_go_on<T>(&mut self, result: &Result<T, DriverError>, losses: &mut u32) -> bool {
        let lost = matches!(result, Err(DriverError::Reopened { .. } | DriverError::Lost { .. }));
        self.forgotten |= lost;
        *losses += 1;
        matches!(result, Err(error) if error.is_reopened()) && *losses <= LOSSES_MAX
    }

    async fn read_checked(&mut self) -> Result<PlateReading, DriverError> {
        let reading = self.inner.read().await?;
        let Some((_, taken)) = self.target else { return Ok(reading) };
        if (reading.set_point - taken).abs() <= SET_POINT_TOLERANCE {
            return Ok(reading);
        }
        let why = format!("it holds the set-point {:.3} where {taken:.3} was set", reading.set_point);
        Err(self.refused(
            "reading the plate",
            why,
            "It was changed at the keypad or by its own program, or the unit was restarted.",
        ))
    }

    fn refused(&self, doing: &str, why: String, hint: &str) -> DriverError {
        DriverError::refused(&self.name, doing, why, hint)
    }
}

#[async_trait]
impl<C: Calibrator> Calibrator for Restored<C> {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        let mut losses = 0;
        loop {
            let identity = self.inner.identify().await;
            if !self.may_go_on(&identity, &mut losses) {
                let identity = identity?;
                self.identity = Some(identity.clone());
                return Ok(identity);
            }
        }
    }

    async fn prepare(&mut self, settings: &CalibratorSettings) -> Result<(), DriverError> {
        self.target = None;
        self.settings = None;
        let mut losses = 0;
        loop {
            let prepared = match self.restore().await {
                Ok(()) => self.inner.prepare(settings).await,
                lost => lost,
            };
            if !self.may_go_on(&prepared, &mut losses) {
                prepared?;
                self.settings = Some(settings.clone());
                return Ok(());
            }
        }
    }

    async fn set_point(&mut self, target: Kelvin) -> Result<Kelvin, DriverError> {
        // Whatever comes of it, the old one is not wanted any more.
        self.target = None;
        let mut losses = 0;
        loop {
            let taken = match self.restore().await {
                Ok(()) => self.inner.set_point(target).await,
                Err(lost) => Err(lost),
            };
            if !self.may_go_on(&taken, &mut losses) {
                let taken = taken?;
                self.target = Some((target, taken));
                return Ok(taken);
            }
        }
    }

    async fn read(&mut self) -> Result<PlateReading, DriverError> {
        let mut losses = 0;
        loop {
            let reading = match self.restore().await {
                Ok(()) => self.read_checked().await,
                Err(lost) => Err(lost),
            };
            if !self.may_go_on(&reading, &mut losses) {
                return reading;
            }
        }
    }

    async fn make_safe(&mut self) -> Result<PlateReading, DriverError> {
        // Nothing may heat it again from here on.
        self.target = None;
        let mut losses = 0;
        loop {
            let reading = self.inner.make_safe().await;
            if !self.may_go_on(&reading, &mut losses) {
                return reading;
            }
        }
    }

    async fn particulars(&mut self) -> Result<Vec<MonitorReading>, DriverError> {
        let mut losses = 0;
        loop {
            let values = match self.restore().await {
                Ok(()) => self.inner.particulars().await,
                Err(lost) => Err(lost),
            };
            if !self.may_go_on(&values, &mut losses) {
                return values;
            }
        }
    }

    fn digit(&self) -> KelvinDelta {
        self.inner.digit()
    }
}

impl<C: std::fmt::Debug> std::fmt::Debug for Restored<C> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Restored")
            .field("inner", &self.inner)
            .field("forgotten", &self.forgotten)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;
    use std::sync::{Arc, Mutex};

    /// What a driver was asked, and what it answers next.
    #[derive(Default)]
    struct Script {
        acts: Vec<String>,
        losses: VecDeque<&'static str>,
        serial: &'static str,
        held_k: f64,
    }

    struct Scripted(Arc<Mutex<Script>>);

    impl Scripted {
        /// Notes an act; lost when the script says so.
        fn act(&self, act: &str) -> Result<(), DriverError> {
            let mut script = self.0.lock().unwrap();
            script.acts.push(act.to_owned());
            let due = script.losses.front().is_some_and(|lost| act.starts_with(*lost));
            if !due {
                return Ok(());
            }
            script.losses.pop_front();
            Err(DriverError::Reopened { who: String::new(), doing: act.to_owned(), why: String::new() })
        }

        fn reading(&self) -> PlateReading {
            let held = Kelvin(self.0.lock().unwrap().held_k);
            PlateReading { apparent: held, block: held, set_point: held, stable: true, tripped: false }
        }
    }

    #[async_trait]
    impl Calibrator for Scripted {
        async fn identify(&mut self) -> Result<Identity, DriverError> {
            self.act("identify")?;
            let text = |text: &str| text.to_owned();
            let serial = text(self.0.lock().unwrap().serial);
            Ok(Identity { maker: text("SIM"), model: text("1"), serial, firmware: text("1") })
        }
        async fn prepare(&mut self, _: &CalibratorSettings) -> Result<(), DriverError> {
            self.act("prepare")
        }
        async fn set_point(&mut self, target: Kelvin) -> Result<Kelvin, DriverError> {
            self.act(&format!("set {}", target.0))?;
            self.0.lock().unwrap().held_k = target.0;
            Ok(target)
        }
        async fn read(&mut self) -> Result<PlateReading, DriverError> {
            self.act("read")?;
            Ok(self.reading())
        }
        async fn make_safe(&mut self) -> Result<PlateReading, DriverError> {
            self.act("safe")?;
            Ok(self.reading())
        }
    }

    fn settings() -> CalibratorSettings {
        CalibratorSettings {
            display_emissivity: 0.95,
            limit: Kelvin(560.0),
            rate_k_per_min: 100.0,
            stability: KelvinDelta(0.4),
        }
    }

    async fn at_work(losses: &[&'static str]) -> (Restored<Scripted>, Arc<Mutex<Script>>) {
        let script = Arc::new(Mutex::new(Script { serial: "7", ..Script::default() }));
        let mut plate = Restored::new(Scripted(Arc::clone(&script)), "plate");
        plate.identify().await.unwrap();
        plate.prepare(&settings()).await.unwrap();
        plate.set_point(Kelvin(400.0)).await.unwrap();
        let mut inside = script.lock().unwrap();
        inside.acts.clear();
        inside.losses = losses.iter().copied().collect();
        drop(inside);
        (plate, script)
    }

    #[tokio::test]
    async fn a_lost_reading_restores_identity_settings_and_set_point_first() {
        let (mut plate, script) = at_work(&["read"]).await;
        plate.read().await.unwrap();
        assert_eq!(script.lock().unwrap().acts, ["read", "identify", "prepare", "set 400", "read"]);
    }

    #[tokio::test]
    async fn a_line_that_goes_again_while_restoring_is_restored_from_the_beginning() {
        let (mut plate, script) = at_work(&["read", "set"]).await;
        plate.read().await.unwrap();
        let acts = ["read", "identify", "prepare", "set 400", "identify", "prepare", "set 400", "read"];
        assert_eq!(script.lock().unwrap().acts, acts);
        let (mut plate, _) = at_work(&["read"; 5]).await;
        assert!(plate.read().await.unwrap_err().is_reopened());
    }

    #[tokio::test]
    async fn the_safe_state_is_never_followed_by_the_old_set_point() {
        let (mut plate, script) = at_work(&["safe"]).await;
        plate.make_safe().await.unwrap();
        plate.read().await.unwrap();
        assert!(!script.lock().unwrap().acts.iter().any(|act| act.starts_with("set")));
        let (mut plate, script) = at_work(&["set 410"]).await;
        plate.set_point(Kelvin(410.0)).await.unwrap();
        assert_eq!(script.lock().unwrap().acts, ["set 410", "identify", "prepare", "set 410"]);
    }

    #[tokio::test]
    async fn another_instrument_and_a_changed_set_point_are_refused() {
        let (mut plate, script) = at_work(&["read"]).await;
        script.lock().unwrap().serial = "8";
        let error = plate.read().await.unwrap_err();
        assert!(error.to_string().contains("1 8 answers where 1 7 did before"), "{error}");
        let (mut plate, script) = at_work(&[]).await;
        script.lock().unwrap().held_k = 400.02;
        let error = plate.read().await.unwrap_err();
        assert!(matches!(error, DriverError::Refused { .. }), "{error}");
        assert!(error.to_string().contains("keypad"), "{error}");
    }
}
