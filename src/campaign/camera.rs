//! The camera of a campaign: prepared, and looked for when it has gone.

use super::{CampaignError, Engine, Interrupt, Step, WISH_POLL, Wish, camera_settings};
use crate::config::Config;
use crate::journal::Record;
use crate::plan::LevelPlan;
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{Camera, CameraSettings};
use tokio::time::{Instant, sleep};

/// Relative difference of the integration time that a camera may round to: far below the 1e-3 that would show.
const INTEGRATION_TOLERANCE: f64 = 1e-6;

/// The camera's trouble: one that is gone is looked for, anything else ends the campaign.
pub(super) fn camera_trouble(error: DriverError) -> Interrupt {
    match error {
        DriverError::Lost { .. } => Interrupt::CameraLost(error),
        other => Interrupt::Error(other.into()),
    }
}

/// Tells the camera what it must do, and holds what it took against it.
pub(super) async fn prepare_camera(camera: &mut dyn Camera, config: &Config) -> Step<()> {
    let wanted = camera_settings(config);
    let taken = camera.prepare(&wanted).await.map_err(camera_trouble)?;
    let same_time = (taken.integration_s / wanted.integration_s - 1.0).abs() < INTEGRATION_TOLERANCE;
    if (CameraSettings { integration_s: wanted.integration_s, ..taken.clone() }) != wanted || !same_time {
        return Err(Interrupt::Error(CampaignError::Driver(DriverError::refused(
            format!("camera at {}", config.camera.address),
            "setting region, integration time and depth",
            format!("asked for {wanted:?}, took {taken:?}"),
            "Write what the camera can do into [camera].",
        ))));
    }
    Ok(())
}

impl Engine<'_> {
    /// Waits for a camera that has gone, for as long as its driver is told, and prepares it from scratch. Injector and
    /// clock stand meanwhile, and the plate is watched; the level then goes on with a new soak and the cycles that are
    /// missing.
    pub(super) async fn find_camera_again(
        &mut self,
        number: u32,
        level: &LevelPlan,
        lost: &DriverError,
    ) -> Step<()> {
        self.instruments.trigger.make_safe().await?;
        let act = format!("look for the camera again ({lost})");
        self.note(Record::Intent { act: act.clone(), level: Some(number) })?;
        self.progress.note(&format!("level {}: {lost} Looking for the camera again.", number + 1));
        self.prepare_lost_camera(number).await?;
        if level.shutter_reference {
            // It may have been closed when the camera went.
            self.instruments.camera.shutter(false).await.map_err(camera_trouble)?;
        }
        self.note(Record::Done { act, level: Some(number) })?;
        Ok(())
    }

    /// The search itself: a wish and a limit of plate or monitors end it at once.
    async fn prepare_lost_camera(&mut self, number: u32) -> Step<()> {
        let (stop, config) = (self.stop.clone(), self.config);
        let (camera, mut watch) = self.camera_and_watch();
        watch.waiting(&format!("level {}: looking for the camera", number + 1));
        let prepared = prepare_camera(camera, config);
        tokio::pin!(prepared);
        let mut look_at = Instant::now();
        loop {
            tokio::select! {
                ended = &mut prepared => return ended,
                () = sleep(WISH_POLL) => {
                    let wish = stop.wish();
                    if wish >= Wish::Pause {
                        return Err(Interrupt::Wish(wish));
                    }
                }
            }
            // Not in the arm above: an exchange is never dropped half-way.
            if Instant::now() >= look_at {
                watch.read(number).await?;
                look_at = Instant::now() + watch.every();
            }
        }
    }
}
