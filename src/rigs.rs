//! Opens a rig: instruments on their wires, or the simulated world behind in-memory ones.

use crate::campaign::{Instruments, MonitorLine, Monitors, Watched};
use crate::config::{self, Config, Pace, SIMULATED, monitor};
use crate::reduce::Reduced;
use crate::truth::WorldTruth;
use ditd_drivers::TRIGGER_UNITS;
use ditd_drivers::error::DriverError;
use ditd_drivers::gige::GigeSettings;
use ditd_drivers::instrument::{Calibrator, Camera, Monitor, TriggerUnit};
use ditd_drivers::monitors::{Absent, Scaled, ascii_query, csv_tail, modbus_registers};
use ditd_drivers::wire::{ByteStream, Opener, Reopening, Wire, WireSettings};
use ditd_sim::rig::build::{self, BuildError};
use ditd_sim::rig::camera::{SimCamera, WorldState};
use ditd_sim::rig::chamber::World;
use ditd_sim::rig::config::RigConfig;
use ditd_sim::rig::plate::Plate;
use ditd_sim::rig::process::{self, SensorMonitor, Sensors};
use ditd_sim::rig::pulse::Pulse;
use ditd_sim::rig::truth::{Sampling, Truth};
use ditd_sim::rig::{fluke_418x as fluke_sim, hart_9132 as hart_sim, ir_301 as ir_sim, line, pulser};
use ditd_sim::scene::library::OwnFile;
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

pub use ditd_sim::rig::build::View;

/// Bytes that an in-memory wire holds before the sender waits: longer than any line of either protocol.
const PIPE_BYTES: usize = 4096;

/// Trigger pulses on their way to the simulated camera; when full, the trigger unit's task waits.
const PULSES_MAX: usize = 16;

/// Perfect shots of the statistical truth: 8 scrambles of 512 leave a standard error far below one run's noise.
const TRUTH: Sampling = Sampling { points: 512, replicates: 8 };

/// Temperatures of the exact calibration's table, in K.
const CURVE_K: std::ops::RangeInclusive<u32> = 250..=850;

/// Why a rig cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// An instrument's line.
    #[error(transparent)]
    Driver(#[from] DriverError),
    /// The simulated world.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// Asked for something that this program or config does not have.
    #[error("{0}")]
    Config(String),
}

impl OpenError {
    /// The process's exit status that stands for it.
    pub fn code(&self) -> u8 {
        match self {
            Self::Driver(error) if error.is_missing_device() => 3,
            Self::Driver(error) if error.is_interlock_or_limit() => 4,
            Self::Driver(_) => 1,
            Self::Build(_) | Self::Config(_) => 2,
        }
    }
}

/// The plate's true surface temperature at every exposure of this session, in K, in order of frame numbers.
type PlateLog = Arc<Mutex<Vec<f64>>>;

/// A rig that is ready to be opened; a simulated one is rendered.
#[derive(Debug)]
pub struct Prepared {
    config: Config,
    world: Option<Arc<World>>,
    log: PlateLog,
    begins: Beginning,
}

/// Where a session begins in the life of a run.
#[derive(Debug, Clone, Copy, Default)]
pub struct Beginning {
    /// Journal time, in ns.
    pub elapsed_ns: u64,
    /// Number of the camera's next frame, on a simulated rig.
    pub frames: u64,
    /// Injections so far, on a simulated rig.
    pub injections: u64,
    /// Whether another session of the same run came before.
    pub resumed: bool,
}

/// Number of the first frame of a simulated calibration: far from those of a campaign, so that the same camera never
/// draws the same noise twice.
const FIRST_CALIBRATION_FRAME: u64 = 1 << 24;

/// An open rig.
#[derive(Debug)]
pub struct Opened {
    /// The instruments.
    pub instruments: Instruments,
}

/// Renders the simulated world, if there is one.
///
/// # Errors
///
/// [`OpenError::Build`] naming what cannot be used.
pub fn prepare(
    config: &Config,
    view: View,
    folder: &Path,
    progress: &(dyn Fn(&str, f64) + Sync),
) -> Result<Prepared, OpenError> {
    // A rig that is simulated behind real lines has its world there.
    let world = match config.rig.as_ref().filter(|_| config.camera.address == SIMULATED) {
        Some(rig) => Some(Arc::new(build::world(rig, view, config.campaign.seed, folder, progress)?)),
        None => None,
    };
    let frames = if view == View::Bench { FIRST_CALIBRATION_FRAME } else { 0 };
    Ok(Prepared { world, begins: Beginning { frames, ..Beginning::default() }, ..without_world(config) })
}

/// The files of the user's own fuel and windows that the simulated world is made from, read and checked: their paths
/// from the campaign file's folder, and their texts.
///
/// # Errors
///
/// [`OpenError::Build`] naming the file and what is wrong.
pub fn own_files(config: &Config, folder: &Path) -> Result<Vec<OwnFile>, OpenError> {
    Ok(config.rig.as_ref().map_or(Ok(Vec::new()), |rig| build::own_files(rig, folder))?)
}

/// A rig whose simulated camera, if it has one, sees nothing: enough to make it safe.
pub fn without_world(config: &Config) -> Prepared {
    Prepared { config: config.clone(), world: None, log: PlateLog::default(), begins: Beginning::default() }
}

impl Prepared {
    /// The runtime of the campaign: virtual time when everything is simulated, real time otherwise.
    ///
    /// # Errors
    ///
    /// The system's words.
    pub fn runtime(&self) -> Result<tokio::runtime::Runtime, String> {
        let mut builder = tokio::runtime::Builder::new_current_thread();
        builder.enable_all();
        builder.start_paused(self.is_virtual());
        builder.build().map_err(|error| format!("starting the runtime: {error}"))
    }

    /// Whether the campaign runs in virtual time.
    pub fn is_virtual(&self) -> bool {
        self.config.campaign.pace == Pace::Max && self.config.is_simulated()
    }

    /// Where this session begins.
    pub fn beginning(&self) -> Beginning {
        self.begins
    }

    /// The same rig, later in the life of a run: noise and shots go on where they were.
    #[must_use]
    pub fn beginning_at(self, begins: Beginning) -> Self {
        Self { begins, ..self }
    }

    /// Opens every instrument, the trigger unit first. When one cannot be opened, those that are open are made safe.
    /// Must run inside the campaign's runtime.
    ///
    /// # Errors
    ///
    /// [`OpenError`] naming the instrument.
    pub async fn open(&self) -> Result<Opened, OpenError> {
        let (pulses, received) = mpsc::channel(PULSES_MAX);
        let start = tokio::time::Instant::now();
        let mut trigger = self.open_trigger(pulses, start).await?;
        let others = match self.open_plate(start).await {
            Ok((mut plate, surface)) => {
                let rest = match self.open_monitors(start).await {
                    Ok(monitors) => {
                        let camera = self.open_camera(surface, received).await;
                        camera.map(|camera| (camera, monitors))
                    }
                    Err(error) => Err(error),
                };
                match rest {
                    Ok((camera, monitors)) => Ok((plate, camera, monitors)),
                    Err(error) => {
                        // The first trouble is the one to tell.
                        let _ = plate.make_safe().await;
                        Err(error)
                    }
                }
            }
            Err(error) => Err(error),
        };
        match others {
            Ok((plate, camera, monitors)) => {
                Ok(Opened { instruments: Instruments { plate, trigger, camera, monitors } })
            }
            Err(error) => {
                let _ = trigger.make_safe().await;
                Err(error)
            }
        }
    }

    /// Opens each instrument on its own and makes it safe at once, injector first: one that is missing does not keep
    /// the others from it. Returns the troubles.
    pub async fn make_safe(&self) -> Vec<OpenError> {
        let (pulses, received) = mpsc::channel(PULSES_MAX);
        let start = tokio::time::Instant::now();
        let mut trouble = Vec::new();
        match self.open_trigger(pulses, start).await {
            Ok(mut trigger) => trouble.extend(trigger.make_safe().await.err().map(OpenError::from)),
            Err(error) => trouble.push(error),
        }
        let mut surface = None;
        match self.open_plate(start).await {
            Ok((mut plate, simulated)) => {
                surface = simulated;
                let made = match plate.identify().await {
                    Ok(_) => plate.make_safe().await,
                    Err(error) => Err(error),
                };
                trouble.extend(made.err().map(OpenError::from));
            }
            Err(error) => trouble.push(error),
        }
        match self.open_camera(surface, received).await {
            Ok(mut camera) => trouble.extend(camera.make_safe().await.err().map(OpenError::from)),
            Err(error) => trouble.push(error),
        }
        trouble
    }

    async fn open_trigger(
        &self,
        pulses: mpsc::Sender<Pulse>,
        start: tokio::time::Instant,
    ) -> Result<Box<dyn TriggerUnit>, OpenError> {
        let config = &self.config;
        let driver = config.trigger.driver.as_str();
        let unknown = || OpenError::Config(format!("trigger.driver: there is no driver {driver:?}"));
        let model = TRIGGER_UNITS.iter().find(|model| model.name == driver).ok_or_else(unknown)?;
        let wire = if config.trigger.address == "sim" {
            let rig = config.rig.as_ref().ok_or_else(no_world)?;
            let (ours, theirs) = tokio::io::duplex(PIPE_BYTES);
            simulate_trigger(driver, rig, theirs, pulses, start)?;
            Wire::over(ours, "trigger unit at sim")
        } else {
            let settings = line_settings(config.trigger.baud, (model.wire_settings)());
            let wire = Wire::open(&config.trigger.address, "trigger unit", &settings).await?;
            wire.reopening(Reopening::for_s(config.trigger.reopen_s))
        };
        Ok((model.drive)(wire, config.trigger_limits()))
    }

    async fn open_plate(
        &self,
        start: tokio::time::Instant,
    ) -> Result<(Box<dyn Calibrator>, Option<Arc<Mutex<Plate>>>), OpenError> {
        let config = &self.config.plate;
        let model = ditd_drivers::calibrator(&config.driver).ok_or_else(|| {
            OpenError::Config(format!("plate.driver: there is no driver {:?}", config.driver))
        })?;
        let policy = Reopening::for_s(config.reopen_s);
        if config.address != "sim" {
            let settings = line_settings(config.baud, (model.wire_settings)());
            let wire = Wire::open(&config.address, "plate calibrator", &settings).await?;
            return Ok(((model.drive)(wire.reopening(policy)), None));
        }
        let rig = self.config.rig.as_ref().ok_or_else(no_world)?;
        let plate = Arc::new(Mutex::new(Plate::new(rig.plate.clone(), self.config.campaign.seed)));
        let opener = calibrator_socket(&config.driver, rig, &plate, start)?;
        let wire = Wire::plugged(opener, "plate calibrator at sim").await?;
        Ok(((model.drive)(wire.reopening(policy)), Some(plate)))
    }

    /// Opens the sources of process values. One that is not required and cannot be opened is told once and left out.
    async fn open_monitors(&self, start: tokio::time::Instant) -> Result<Monitors, OpenError> {
        let mut lines = Vec::with_capacity(self.config.monitors.len());
        for monitor in &self.config.monitors {
            let source: Box<dyn Monitor> = match self.open_monitor(monitor, start).await {
                Ok(source) => source,
                Err(OpenError::Driver(error)) if !monitor.required => Box::new(Absent(error)),
                Err(error) => return Err(error),
            };
            let values = monitor.values.iter();
            let values = values.map(|v| Watched { name: v.name.clone(), low: v.low, high: v.high }).collect();
            lines.push(MonitorLine {
                name: monitor.name.clone(),
                required: monitor.required,
                values,
                source,
            });
        }
        Ok(Monitors::new(lines))
    }

    async fn open_monitor(
        &self,
        monitor: &config::Monitor,
        start: tokio::time::Instant,
    ) -> Result<Box<dyn Monitor>, OpenError> {
        let role = format!("monitor {}", monitor.name);
        let policy = Reopening::for_s(monitor.reopen_s);
        match monitor.driver.as_str() {
            "ascii_query" => {
                let fields = monitor.values.iter().map(ascii_field).collect();
                let ending = match monitor.ending.as_deref() {
                    Some("\r") => ascii_query::Ending::Cr,
                    Some("\n") => ascii_query::Ending::Lf,
                    _ => ascii_query::Ending::CrLf,
                };
                let deadline = Duration::from_secs_f64(monitor.timeout_s.unwrap_or(ANSWER_S));
                let wire = if monitor.address == "sim" {
                    let rig = self.config.rig.as_ref().ok_or_else(no_world)?;
                    let (own, seed) = (rig.clone(), self.config.campaign.seed);
                    let faults = rig.process.as_ref().map(|process| process.line_faults.clone());
                    let name = format!("{role} at sim");
                    let opener =
                        line::opener(name.clone(), faults.unwrap_or_default(), start, move |stream| {
                            drop(simulate_sensors(&own, stream, seed, start));
                        });
                    Wire::plugged(opener, name).await?
                } else {
                    let settings = line_settings(monitor.baud, ascii_query::wire_settings());
                    Wire::open(&monitor.address, &role, &settings).await?
                };
                Ok(Box::new(ascii_query::AsciiQuery::new(wire.reopening(policy), ending, deadline, fields)))
            }
            "modbus_registers" => {
                let values = monitor.values.iter().map(register_value).collect();
                let settings = line_settings(monitor.baud, modbus_registers::wire_settings());
                let wire = Wire::open(&monitor.address, &role, &settings).await?.reopening(policy);
                let unit = monitor.unit.unwrap_or(1);
                Ok(Box::new(modbus_registers::ModbusRegisters::new(wire, unit, values)))
            }
            "csv_tail" => {
                let path = monitor.address.strip_prefix("file:").unwrap_or(&monitor.address);
                let columns = monitor.values.iter().map(|value| csv_tail::Column {
                    column: value.column.clone().unwrap_or_default(),
                    value: scaled(value),
                });
                let stale = Duration::from_secs_f64(monitor.stale_s.unwrap_or(STALE_S));
                let separator = monitor.separator.unwrap_or(',');
                Ok(Box::new(csv_tail::CsvTail::new(path.into(), separator, stale, columns.collect())))
            }
            "sim" => {
                let rig = self.config.rig.as_ref().ok_or_else(no_world)?;
                let sensors = Sensors::new(rig, self.config.campaign.seed, start);
                let names = monitor.values.iter().map(|value| value.name.clone()).collect();
                Ok(Box::new(SensorMonitor::new(sensors, names)))
            }
            other => Err(OpenError::Config(format!("monitor.driver: there is no driver {other:?}"))),
        }
    }

    async fn open_camera(
        &self,
        plate: Option<Arc<Mutex<Plate>>>,
        pulses: mpsc::Receiver<Pulse>,
    ) -> Result<Box<dyn Camera>, OpenError> {
        let camera = &self.config.camera;
        if camera.address == SIMULATED {
            return Ok(Box::new(self.simulated_camera(plate, pulses)?));
        }
        open_gige(&camera.address, &camera.gige.clone().unwrap_or_default()).await
    }

    fn simulated_camera(
        &self,
        plate: Option<Arc<Mutex<Plate>>>,
        pulses: mpsc::Receiver<Pulse>,
    ) -> Result<SimCamera, OpenError> {
        let rig = self.config.rig.as_ref().ok_or_else(no_world)?;
        let world = match &self.world {
            Some(world) => Arc::clone(world),
            None => Arc::new(build::world(
                &RigConfig { spray: None, ..rig.clone() },
                View::Bench,
                self.config.campaign.seed,
                Path::new(""),
                &|_, _| {},
            )?),
        };
        let log = Arc::clone(&self.log);
        let state = WorldState {
            exposures: self.begins.frames,
            injections: self.begins.injections,
            ..WorldState::default()
        };
        let surface = move |now_s: f64| {
            let kelvin = match &plate {
                Some(plate) => {
                    let mut plate = plate.lock().unwrap_or_else(PoisonError::into_inner);
                    plate.advance(now_s);
                    plate.surface_k()
                }
                // A real plate in front of a simulated camera: the camera sees the room.
                None => 296.0,
            };
            log.lock().unwrap_or_else(PoisonError::into_inner).push(kelvin);
            kelvin
        };
        Ok(SimCamera::switch_on(world, Box::new(surface), rig.faults.clone(), state, pulses))
    }

    /// What the simulated world knows of itself at the accepted shots; `None` on a real rig or without a spray.
    ///
    /// # Errors
    ///
    /// [`OpenError::Build`] when the world cannot tell.
    pub fn truth(
        &self,
        reduced: &Reduced,
        config: &Config,
        folder: &Path,
    ) -> Result<Option<WorldTruth>, OpenError> {
        let (Some(world), Some(rig)) = (&self.world, &config.rig) else { return Ok(None) };
        if rig.spray.is_none() || reduced.levels.iter().any(|level| level.spray_ids.is_empty()) {
            return Ok(None);
        }
        let surface = read_surface(folder);
        let plate_k: Vec<f64> =
            reduced.levels.iter().map(|level| mean_surface(&surface, &level.spray_ids)).collect();
        if plate_k.iter().any(|kelvin| !kelvin.is_finite()) {
            return Ok(None);
        }
        let integration_s = config.camera.integration_s;
        let truth = Truth::new(world, &plate_k, integration_s, TRUTH).map_err(BuildError::from)?;
        let optics = world.optics();
        let mean_k = plate_k.iter().sum::<f64>() / plate_k.len() as f64;
        let (_, gamma_near) = optics.window_transmittances(mean_k);
        let image = |values: &[f64], fill: f64| truth.image(values, fill);
        Ok(Some(WorldTruth {
            rows: truth.rows,
            columns: truth.columns,
            x_counts: plate_k
                .iter()
                .map(|kelvin| {
                    let (gamma_far, _) = optics.window_transmittances(*kelvin);
                    gamma_far * optics.calibration_counts(*kelvin, integration_s)
                })
                .collect(),
            plate_k,
            difference_counts: truth
                .statistical
                .difference_counts
                .iter()
                .map(|level| image(level, 0.0))
                .collect(),
            difference_error_counts: truth
                .statistical
                .standard_error_counts
                .iter()
                .map(|level| image(level, 0.0))
                .collect(),
            gamma_near,
            emissivity_plate: rig.plate_view.emissivity,
            far_window_counts: optics.far_window_counts(integration_s),
            curve_k: CURVE_K.map(f64::from).collect(),
            curve_counts: CURVE_K.map(|t| optics.calibration_counts(f64::from(t), integration_s)).collect(),
            physical_k: image(&truth.physical.temperature_k, f64::NAN),
            physical_emissivity: image(&truth.physical.emissivity, 0.0),
            droplets_k: image(&truth.droplets.temperature_k, f64::NAN),
            droplets_emissivity: image(&truth.droplets.emissivity, 0.0),
        }))
    }

    /// Adds the plate's true surface temperature at this session's exposures to `world/surface.csv`.
    ///
    /// # Errors
    ///
    /// [`OpenError::Config`] with the system's words.
    pub fn keep_surface(&self, folder: &Path) -> Result<(), OpenError> {
        let log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        if self.world.is_none() || log.is_empty() {
            return Ok(());
        }
        let path = folder.join(SURFACE);
        let text: String = log
            .iter()
            .enumerate()
            .map(|(index, kelvin)| format!("{},{kelvin:?}\n", self.begins.frames + index as u64))
            .collect();
        let write = || -> std::io::Result<()> {
            std::fs::create_dir_all(folder.join("world"))?;
            let mut file = std::fs::File::options().create(true).append(true).open(&path)?;
            file.write_all(text.as_bytes())
        };
        write().map_err(|error| OpenError::Config(format!("{}: {error}", path.display())))
    }
}

/// The plate's true surface temperature at every exposure of a simulated run: frame number, K.
const SURFACE: &str = "world/surface.csv";

fn read_surface(folder: &Path) -> HashMap<u64, f64> {
    let text = std::fs::read_to_string(folder.join(SURFACE)).unwrap_or_default();
    text.lines()
        .filter_map(|line| {
            let (frame, kelvin) = line.split_once(',')?;
            Some((frame.parse().ok()?, kelvin.parse().ok()?))
        })
        .collect()
}

/// Mean true surface temperature at the frames of which it is known; NaN without any.
fn mean_surface(surface: &HashMap<u64, f64>, frames: &[u64]) -> f64 {
    let seen: Vec<f64> = frames.iter().filter_map(|frame| surface.get(frame).copied()).collect();
    if seen.is_empty() { f64::NAN } else { seen.iter().sum::<f64>() / seen.len() as f64 }
}

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

#[cfg(feature = "aravis")]
async fn open_gige(address: &str, settings: &GigeSettings) -> Result<Box<dyn Camera>, OpenError> {
    Ok(Box::new(ditd_drivers::gige::GigeCamera::open(address, settings).await?))
}

#[cfg(not(feature = "aravis"))]
#[expect(clippy::unused_async, reason = "as the one with cameras")]
async fn open_gige(address: &str, _: &GigeSettings) -> Result<Box<dyn Camera>, OpenError> {
    Err(OpenError::Driver(DriverError::Missing {
        who: format!("camera at {address}"),
        why: ditd_drivers::gige::WITHOUT_ARAVIS.to_owned(),
        hint: "Or run the simulated camera: driver = \"sim\", address = \"sim\".".to_owned(),
    }))
}

/// The instrument's delivered line settings, with the campaign file's baud rate.
fn line_settings(baud: Option<u32>, delivered: WireSettings) -> WireSettings {
    baud.map_or(delivered, |baud| WireSettings { baud })
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

/// Longest wait for the answer of a monitor, in s, unless the campaign file says another.
const ANSWER_S: f64 = 1.0;

/// A file without a new line for so long is stale, in s; the campaign file has to say it, so that this is never used.
const STALE_S: f64 = 60.0;

fn scaled(value: &config::MonitorValue) -> Scaled {
    Scaled { name: value.name.clone(), scale: value.scale, offset: value.offset }
}

fn ascii_field(value: &config::MonitorValue) -> ascii_query::Field {
    ascii_query::Field {
        query: value.query.clone().unwrap_or_default(),
        field: value.field.unwrap_or(0),
        value: scaled(value),
    }
}

fn register_value(value: &config::MonitorValue) -> modbus_registers::RegisterValue {
    use modbus_registers::{RegisterType, Table, WordOrder};
    modbus_registers::RegisterValue {
        table: if value.function == Some(4) { Table::Input } else { Table::Holding },
        register: value.register.unwrap_or(0),
        kind: match value.kind {
            Some(monitor::Kind::I16) => RegisterType::I16,
            Some(monitor::Kind::U32) => RegisterType::U32,
            Some(monitor::Kind::I32) => RegisterType::I32,
            Some(monitor::Kind::F32) => RegisterType::F32,
            Some(monitor::Kind::U16) | None => RegisterType::U16,
        },
        order: match value.word_order {
            Some(monitor::WordOrder::LowFirst) => WordOrder::LowFirst,
            Some(monitor::WordOrder::HighFirst) | None => WordOrder::HighFirst,
        },
        value: scaled(value),
    }
}

fn no_world() -> OpenError {
    OpenError::Config("address \"sim\" needs a [rig] table that describes the simulated world".to_owned())
}
