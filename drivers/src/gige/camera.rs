//! The daemon's side of a GigE camera.

use super::GigeSettings;
use super::worker::{Order, Worker};
use crate::error::DriverError;
use crate::instrument::{Camera, CameraClock, CameraSettings, Frame, Identity};
use crate::quantity::Kelvin;
use async_trait::async_trait;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio::time::{Instant, sleep, timeout};

/// Longest time of one order. The library gives up on a camera that is gone after 2.5 to 5 s a call (measured); a
/// preparation has some twenty of them, but the first that fails ends it.
const ORDER_DEADLINE: Duration = Duration::from_secs(30);

/// Between two tries to find a camera that has gone.
const RETRY_EVERY: Duration = Duration::from_millis(200);

/// A GenICam camera on GigE Vision.
pub struct GigeCamera {
    who: String,
    worker: Worker,
    reconnect: Duration,
    frames: Option<mpsc::Receiver<Result<Frame, DriverError>>>,
    counters: Vec<(&'static str, u64)>,
    /// Who it was when it was asked first.
    identity: Option<Identity>,
    /// The line is known to be gone: the camera must be opened anew.
    lost: bool,
}

impl std::fmt::Debug for GigeCamera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GigeCamera").field("who", &self.who).field("lost", &self.lost).finish_non_exhaustive()
    }
}

impl GigeCamera {
    /// Opens the camera at a network address (or with a name that the library knows it by) and takes control of it.
    ///
    /// # Errors
    /// [`DriverError::Missing`] when nothing answers there or another program has it.
    pub async fn open(address: &str, settings: &GigeSettings) -> Result<Self, DriverError> {
        let who = format!("camera at {address}");
        let worker = Worker::start(who.clone(), address.to_owned(), settings.clone()).map_err(|error| {
            DriverError::Missing {
                who: who.clone(),
                why: format!("its thread cannot be started: {error}"),
                hint: "Look at the limits of this process (ulimit -u).".to_owned(),
            }
        })?;
        let mut camera = Self {
            who,
            worker,
            reconnect: Duration::from_secs_f64(settings.reconnect_s.clamp(0.0, 3600.0)),
            frames: None,
            counters: Vec::new(),
            identity: None,
            lost: false,
        };
        camera.order("opening it", Order::Open).await?;
        Ok(camera)
    }

    async fn order<T>(
        &mut self,
        doing: &str,
        order: impl FnOnce(oneshot::Sender<Result<T, DriverError>>) -> Order,
    ) -> Result<T, DriverError> {
        let (answer, received) = oneshot::channel();
        if !self.worker.order(order(answer)) {
            return Err(self.dead(doing));
        }
        let result = match timeout(ORDER_DEADLINE, received).await {
            Ok(Ok(result)) => result,
            Ok(Err(_)) => Err(self.dead(doing)),
            Err(_) => Err(DriverError::Silent {
                who: self.who.clone(),
                doing: doing.to_owned(),
                waited: ORDER_DEADLINE,
                tries: 1,
                hint: "Check the camera's power and network cable.".to_owned(),
            }),
        };
        if let Err(DriverError::Lost { .. }) = &result {
            self.lost = true;
        }
        result
    }

    fn dead(&self, doing: &str) -> DriverError {
        DriverError::lost(
            &self.who,
            doing,
            "the camera's thread has ended",
            "This is a mistake of the program: please report it.",
        )
    }

    /// Looks for a camera that has gone until it is there or the time is over.
    async fn reopen(&mut self) -> Result<(), DriverError> {
        let until = Instant::now() + self.reconnect;
        loop {
            let opened = self.order("opening it again", Order::Open).await;
            match opened {
                Ok(()) => {
                    self.lost = false;
                    return Ok(());
                }
                Err(error) if Instant::now() >= until => return Err(error),
                Err(_) => sleep(RETRY_EVERY).await,
            }
        }
    }
}

#[async_trait]
impl Camera for GigeCamera {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        let identity = self.order("asking who it is", Order::Identify).await?;
        self.identity = Some(identity.clone());
        Ok(identity)
    }

    async fn prepare(&mut self, settings: &CameraSettings) -> Result<CameraSettings, DriverError> {
        self.frames = None;
        if self.lost {
            self.reopen().await?;
            let found = self.order("asking who it is", Order::Identify).await?;
            is_same(&self.who, self.identity.as_ref(), &found)?;
        }
        self.order("preparing", |answer| Order::Prepare(settings.clone(), answer)).await
    }

    async fn shutter(&mut self, closed: bool) -> Result<Option<Kelvin>, DriverError> {
        self.order("moving the shutter", |answer| Order::Shutter(closed, answer)).await
    }

    async fn correct_offset(&mut self) -> Result<(), DriverError> {
        self.order("taking a new offset", Order::CorrectOffset).await
    }

    async fn clock(&mut self) -> Result<Option<CameraClock>, DriverError> {
        self.order("asking for its clock", Order::Clock).await
    }

    async fn start(&mut self) -> Result<(), DriverError> {
        self.frames = None;
        self.frames = Some(self.order("starting the stream", Order::Start).await?);
        Ok(())
    }

    async fn frame(&mut self, deadline: Duration) -> Result<Frame, DriverError> {
        const DOING: &str = "waiting for a frame";
        let Some(frames) = &mut self.frames else {
            return Err(DriverError::refused(&self.who, DOING, "it was not started", "Start it first."));
        };
        match timeout(deadline, frames.recv()).await {
            Ok(Some(Ok(frame))) => Ok(frame),
            Ok(Some(Err(error))) => {
                self.lost |= matches!(error, DriverError::Lost { .. });
                self.frames = None;
                Err(error)
            }
            Ok(None) => {
                self.lost = true;
                Err(self.dead(DOING))
            }
            Err(_) => Err(DriverError::Silent {
                who: self.who.clone(),
                doing: DOING.to_owned(),
                waited: deadline,
                tries: 1,
                hint: "Check the trigger cable and that the trigger unit runs.".to_owned(),
            }),
        }
    }

    async fn stop(&mut self) -> Result<(), DriverError> {
        self.frames = None;
        self.counters = self.order("stopping", Order::Stop).await?;
        Ok(())
    }

    async fn check(&mut self) -> Result<(), DriverError> {
        self.order("asking whether it is still there", Order::Check).await
    }

    fn counters(&self) -> Vec<(&'static str, u64)> {
        self.counters.clone()
    }

    /// A camera that is gone counts as safe: it makes no light and no pulse, and stops its stream by itself.
    async fn make_safe(&mut self) -> Result<(), DriverError> {
        self.stop().await
    }
}

/// Another camera at the old address has another calibration: its counts would mean other temperatures.
fn is_same(who: &str, before: Option<&Identity>, found: &Identity) -> Result<(), DriverError> {
    let Some(before) = before else { return Ok(()) };
    if (&before.model, &before.serial) == (&found.model, &found.serial) {
        return Ok(());
    }
    let why = format!(
        "{} {} answers where {} {} did before",
        found.model, found.serial, before.model, before.serial
    );
    let hint = "Plug the right camera in again, or start a new campaign.";
    Err(DriverError::refused(who, "asking who it is after it was gone", why, hint))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_camera_at_the_same_address_is_refused() {
        let camera = |serial: &str| Identity {
            maker: "maker".to_owned(),
            model: "X6900sc".to_owned(),
            serial: serial.to_owned(),
            firmware: "1".to_owned(),
        };
        assert!(is_same("camera", None, &camera("7")).is_ok());
        let updated = Identity { firmware: "2".to_owned(), ..camera("7") };
        assert!(is_same("camera", Some(&camera("7")), &updated).is_ok());
        let error = is_same("camera", Some(&camera("7")), &camera("8")).unwrap_err();
        assert!(error.to_string().contains("X6900sc 8 answers where X6900sc 7"), "{error}");
    }
}
