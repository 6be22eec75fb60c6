//! Puts simulated instruments on streams: in-memory pipes, pseudo-terminals, connections.

use super::OpenError;
use ditd_drivers::wire::{ByteStream, Opener};
use ditd_sim::rig::config::RigConfig;
use ditd_sim::rig::plate::Plate;
use ditd_sim::rig::process::{self, Sensors};
use ditd_sim::rig::pulse::Pulse;
use ditd_sim::rig::{fluke_418x as fluke_sim, hart_9132 as hart_sim, ir_301 as ir_sim, line, pulser};
use std::sync::{Arc, Mutex};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// Puts a simulated trigger unit on a stream. Ends when the stream's other side has gone.
///
/// # Errors
///
/// [`OpenError::Config`] for a driver that nothing simulates.
pub fn simulate_trigger(
    driver: &str,
    rig: &RigConfig,
    stream: impl ByteStream + 'static,
    pulses: mpsc::Sender<Pulse>,
    start: tokio::time::Instant,
) -> Result<JoinHandle<()>, OpenError> {
    let unit = pulser::model(driver)
        .ok_or_else(|| OpenError::Config(format!("trigger.driver: nothing simulates {driver:?}")))?;
    Ok(tokio::spawn(pulser::serve(unit, stream, pulses, rig.pulser.clone(), start)))
}

/// Puts a simulated calibrator with its plate on a stream. Ends when the stream's other side has gone.
///
/// # Errors
///
/// [`OpenError::Config`] for a driver that nothing simulates.
pub fn simulate_plate(
    driver: &str,
    rig: &RigConfig,
    stream: impl ByteStream + 'static,
    plate: Arc<Mutex<Plate>>,
    start: tokio::time::Instant,
) -> Result<JoinHandle<()>, OpenError> {
    Ok(match driver {
        "fluke_418x" => tokio::spawn(fluke_sim::serve(stream, plate, rig.calibrator.clone(), start)),
        "hart_9132" => tokio::spawn(hart_sim::serve(stream, plate, rig.hart_9132.clone(), start)),
        "ir_301" => tokio::spawn(ir_sim::serve(stream, plate, rig.ir_301.clone(), start)),
        _ => return Err(not_simulated(driver)),
    })
}

/// The simulated rig's sensors on a stream, as an instrument that answers lines of text.
pub fn simulate_sensors(
    rig: &RigConfig,
    stream: impl ByteStream + 'static,
    seed: u64,
    start: tokio::time::Instant,
) -> JoinHandle<()> {
    tokio::spawn(process::serve(stream, Sensors::new(rig, seed, start)))
}

/// Where the simulated calibrator of a driver is plugged in.
///
/// # Errors
///
/// [`OpenError::Config`] for a driver that nothing simulates.
pub fn calibrator_socket(
    driver: &str,
    rig: &RigConfig,
    plate: &Arc<Mutex<Plate>>,
    start: tokio::time::Instant,
) -> Result<Opener, OpenError> {
    let faults = match driver {
        "fluke_418x" => &rig.calibrator.faults,
        "hart_9132" => &rig.hart_9132.faults,
        "ir_301" => &rig.ir_301.faults,
        _ => return Err(not_simulated(driver)),
    };
    let (driver, rig, plate) = (driver.to_owned(), rig.clone(), Arc::clone(plate));
    Ok(line::opener("plate calibrator at sim", faults.clone(), start, move |stream| {
        // The driver was found above; a socket without anything behind it would be heard at once.
        drop(simulate_plate(&driver, &rig, stream, Arc::clone(&plate), start));
    }))
}

fn not_simulated(driver: &str) -> OpenError {
    OpenError::Config(format!("plate.driver: nothing simulates {driver:?}"))
}
