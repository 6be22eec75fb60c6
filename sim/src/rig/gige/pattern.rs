//! A camera that shows a test pattern: for trying a driver, or a network, without a world.
//!
//! Every pixel follows from the frame's id and its place, so that a client can check what it got. Exposes on pulses,
//! as the simulated camera does.

use crate::rig::pulse::Pulse;
use async_trait::async_trait;
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{Camera, CameraSettings, Frame, Identity};
use ditd_drivers::quantity::Kelvin;
use std::time::Duration;
use tokio::sync::mpsc;

const WHO: &str = "pattern camera";

/// Temperature of the shutter, in kelvin.
const SHUTTER_K: f64 = 300.0;

/// Least and greatest count of the pattern.
const FIRST: u16 = 1000;
/// See [`FIRST`].
const LAST: u16 = 8191;

/// Count that a closed shutter shows.
pub const SHUTTER_COUNT: u16 = 700;

/// A camera with a test pattern.
#[derive(Debug)]
pub struct PatternCamera {
    settings: CameraSettings,
    pulses: mpsc::Receiver<Pulse>,
    exposures: u64,
    running: bool,
    shutter_closed: bool,
}

impl PatternCamera {
    /// A camera of so many rows and columns; it exposes when a pulse with a camera output comes.
    pub fn new(rows: usize, columns: usize, bits: u32, pulses: mpsc::Receiver<Pulse>) -> Self {
        let settings = CameraSettings { rows, columns, integration_s: 1e-3, bits };
        Self { settings, pulses, exposures: 0, running: false, shutter_closed: false }
    }

    fn drain(&mut self) {
        while self.pulses.try_recv().is_ok() {}
    }
}

/// The count of a pixel of frame `id`: rises by one from column to column and by three from row to row and from frame to
/// frame, from 1000 to 8191. Fits into 13 bits.
pub fn pattern_count(id: u64, row: usize, column: usize) -> u16 {
    let steps = u64::from(LAST - FIRST) + 1;
    let phase = (3 * (id % steps) + 3 * row as u64 + column as u64) % steps;
    #[expect(clippy::cast_possible_truncation, reason = "below 8192")]
    let count = FIRST + phase as u16;
    count
}

/// The whole picture of frame `id`.
fn pattern(id: u64, rows: usize, columns: usize) -> Vec<u16> {
    let mut counts = Vec::with_capacity(rows * columns);
    for row in 0..rows {
        let mut count = pattern_count(id, row, 0);
        for _ in 0..columns {
            counts.push(count);
            count = if count == LAST { FIRST } else { count + 1 };
        }
    }
    counts
}

#[async_trait]
impl Camera for PatternCamera {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        Ok(Identity {
            maker: "ditd".to_owned(),
            model: "pattern camera".to_owned(),
            serial: "PATTERN-0001".to_owned(),
            firmware: env!("CARGO_PKG_VERSION").to_owned(),
        })
    }

    async fn prepare(&mut self, settings: &CameraSettings) -> Result<CameraSettings, DriverError> {
        let own = &self.settings;
        if (settings.rows, settings.columns, settings.bits) != (own.rows, own.columns, own.bits) {
            return Err(DriverError::refused(
                WHO,
                "setting the region",
                format!("{settings:?} asked, it has {own:?}"),
                "Ask for what it has.",
            ));
        }
        self.settings.integration_s = settings.integration_s;
        Ok(settings.clone())
    }

    async fn shutter(&mut self, closed: bool) -> Result<Option<Kelvin>, DriverError> {
        self.shutter_closed = closed;
        Ok(closed.then_some(Kelvin(SHUTTER_K)))
    }

    async fn start(&mut self) -> Result<(), DriverError> {
        self.drain();
        self.running = true;
        Ok(())
    }

    async fn frame(&mut self, deadline: Duration) -> Result<Frame, DriverError> {
        const DOING: &str = "waiting for a frame";
        let pulses = &mut self.pulses;
        let next = async {
            loop {
                match pulses.recv().await {
                    Some(Pulse { at_ns, camera: Some((delay_ns, _)), .. }) => break Some(at_ns + delay_ns),
                    Some(_) => {}
                    None => break None,
                }
            }
        };
        let device_ns = match tokio::time::timeout(deadline, next).await {
            Ok(Some(device_ns)) => device_ns,
            Ok(None) => {
                return Err(DriverError::lost(
                    WHO,
                    DOING,
                    "nobody makes pulses any more",
                    "Start the rig anew.",
                ));
            }
            Err(_) => {
                return Err(DriverError::Silent {
                    who: WHO.to_owned(),
                    doing: DOING.to_owned(),
                    waited: deadline,
                    tries: 1,
                    hint: "Check the trigger.".to_owned(),
                });
            }
        };
        let id = self.exposures;
        self.exposures += 1;
        let (rows, columns) = (self.settings.rows, self.settings.columns);
        let counts = if self.shutter_closed {
            vec![SHUTTER_COUNT; rows * columns]
        } else {
            pattern(id, rows, columns)
        };
        Ok(Frame { id, device_ns, rows, columns, counts: counts.into(), complete: true })
    }

    async fn stop(&mut self) -> Result<(), DriverError> {
        self.running = false;
        self.drain();
        Ok(())
    }

    async fn make_safe(&mut self) -> Result<(), DriverError> {
        self.stop().await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picture_and_single_counts_agree() {
        let (rows, columns) = (40, 640);
        for id in [0, 2300, u64::MAX] {
            let picture = pattern(id, rows, columns);
            for (place, &count) in picture.iter().enumerate() {
                assert_eq!(count, pattern_count(id, place / columns, place % columns), "{id} {place}");
            }
        }
    }
}
