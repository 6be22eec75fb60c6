//! Figures of instruments on their lines: exchanges over a pseudo-terminal, frames of a GigE camera on loopback.
//!
//! The error of a figure is what was lost on the way. The camera is the simulated one with a test pattern, in this same
//! process: both ends share the machine, so that rates are floors.

use super::{Figure, Watch};
use crate::campaign::{Label, Recorder};
use crate::commands::CommandError;
use crate::config::Config;
use crate::journal::Record;
use crate::plan::Plan;
use crate::reduce::Reduced;
use crate::samples;
use ditd_drivers::error::DriverError;
use ditd_drivers::gige::{GigeCamera, GigeSettings};
use ditd_drivers::instrument::{Camera, CameraSettings, Frame, ShotKind};
use ditd_drivers::wire::{LineHabits, Wire, WireSettings};
use ditd_sim::rig::fluke_418x::{self, FlukeBehaviour};
use ditd_sim::rig::gige::pattern::{PatternCamera, pattern_count};
use ditd_sim::rig::gige::{GigeCamera as Served, GigeServer, Sensor};
use ditd_sim::rig::plate::{Plate, PlateModel};
use ditd_sim::rig::pulse::Pulse;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, sleep_until};

const ROWS: usize = 512;
const COLUMNS: usize = 640;

/// Exchanges that are timed.
const EXCHANGES: usize = 2000;

/// Frames of the main figure.
const FRAMES: usize = 2000;

/// Frames at each rate of the search for the highest.
const FRAMES_OF_A_RATE: usize = 400;

/// Rates that are tried, in Hz, until one loses a frame.
const RATES_HZ: [f64; 7] = [150.0, 200.0, 250.0, 300.0, 400.0, 500.0, 600.0];

/// A frame that has not come after this long does not come.
const DEADLINE: Duration = Duration::from_millis(1500);

/// What is asked.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder in which the journal of the latency's figure is written, and removed again
    #[arg(long, value_name = "DIR", default_value = ".")]
    folder: PathBuf,
    /// Loopback address of the camera
    #[arg(long, default_value = "127.0.0.91")]
    address: Ipv4Addr,
    #[command(flatten)]
    pub(super) output: super::Output,
}

/// All figures.
pub(super) fn figures(watch: &Watch<'_>, args: &Args) -> Result<Vec<Figure>, CommandError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| CommandError::failure(format!("starting the runtime: {error}")))?;
    runtime.block_on(all(watch, args)).map_err(CommandError::failure)
}

async fn all(watch: &Watch<'_>, args: &Args) -> Result<Vec<Figure>, String> {
    let mut figures = exchanges(watch).await?;
    for (packet_socket, socket) in [(true, "packet socket"), (false, "UDP socket")] {
        for packet_size in [1500, 9000] {
            let settings =
                GigeSettings { packet_socket, packet_size: Some(packet_size), ..GigeSettings::default() };
            let kind = format!("{socket}, packets of {packet_size}");
            let run = stream(args.address, &settings, 100.0, FRAMES).await?;
            figures.push(figure(
                &format!("100 frames/s, {kind}"),
                run.seconds,
                run.lost as f64,
                "frames lost",
                FRAMES,
            ));
            let mut highest = run;
            for hz in RATES_HZ {
                let run = stream(args.address, &settings, hz, FRAMES_OF_A_RATE).await?;
                // Slower than it should be: the sending side is at its end.
                if run.lost > 0 || run.hz() < 0.9 * hz {
                    break;
                }
                highest = run;
            }
            figures.push(figure(
                &format!("{:.0} frames/s, the most without a loss, {kind}", highest.hz()),
                highest.seconds,
                highest.lost as f64,
                "frames lost",
                highest.frames,
            ));
        }
    }
    figures.extend(latency(args.address, &args.folder).await?);
    figures.push(reconnect(args.address).await?);
    Ok(figures)
}

fn figure(name: &str, seconds: f64, error: f64, error_kind: &str, n: usize) -> Figure {
    Figure {
        name: name.to_owned(),
        seconds,
        error,
        error_kind: error_kind.to_owned(),
        n,
        threads: 1,
        seed: None,
    }
}

/// Questions and answers over a pseudo-terminal; the instrument answers at once.
async fn exchanges(watch: &Watch<'_>) -> Result<Vec<Figure>, String> {
    use tokio_serial::{SerialPort, SerialStream};
    let (far, near) = SerialStream::pair().map_err(|error| error.to_string())?;
    // Held to the end: a terminal that nobody has open hangs up, and its other side never forgets that.
    let address = format!("serial:{}", near.name().ok_or("the pseudo-terminal has no name")?);
    let behaviour = FlukeBehaviour { reply_delay_s: 0.0, ..FlukeBehaviour::fluke_4181() };
    let plate = Arc::new(Mutex::new(Plate::new(PlateModel::fluke_4181(296.0), 1)));
    let served = tokio::spawn(fluke_418x::serve(far, plate, behaviour, Instant::now()));
    let settings = WireSettings { baud: 9600 };
    let words = |error: DriverError| error.to_string();
    let mut wire = Wire::open(&address, "plate calibrator", &settings).await.map_err(words)?;
    wire.adopt(LineHabits::plain());
    let mut times = Vec::with_capacity(EXCHANGES);
    let mut wrong = 0;
    for _ in 0..EXCHANGES {
        let begun = watch.clock.elapsed();
        let answer = wire.ask("*IDN?", "timing").await.map_err(words)?;
        times.push((watch.clock.elapsed() - begun).as_secs_f64());
        wrong += usize::from(!answer.starts_with("FLUKE,"));
    }
    served.abort();
    drop(near);
    times.sort_by(f64::total_cmp);
    let at = |part: usize| times[(times.len() - 1) * part / 100];
    Ok([(50, "median"), (99, "99 of 100 within")]
        .map(|(part, name)| {
            figure(
                &format!("exchange over a pseudo-terminal, {name}"),
                at(part),
                wrong as f64,
                "wrong answers",
                1,
            )
        })
        .into())
}

struct Run {
    seconds: f64,
    lost: usize,
    frames: usize,
}

impl Run {
    fn hz(&self) -> f64 {
        self.frames as f64 / self.seconds
    }
}

/// A camera with a trigger unit that pulses it at `hz` from now on.
async fn serve(address: Ipv4Addr, hz: f64) -> Result<(GigeServer, JoinHandle<()>, Instant), String> {
    let (pulses, taken) = mpsc::channel(8);
    let start = Instant::now();
    let sensor = Sensor { rows: 512, columns: 640, bits: 14, shutter: false };
    let behind = PatternCamera::new(ROWS, COLUMNS, 14, taken);
    let server = Served::new(Box::new(behind), sensor)
        .clock(start, 0)
        .serve(address)
        .await
        .map_err(|error| error.to_string())?;
    let pulsing = tokio::spawn(async move {
        for t0_index in 0_u64.. {
            let at = Duration::from_secs_f64(t0_index as f64 / hz);
            sleep_until(start + at).await;
            let at_ns = u64::try_from(at.as_nanos()).unwrap_or(u64::MAX);
            // Nobody takes them while the camera is stopped.
            let _ = pulses.try_send(Pulse { t0_index, at_ns, camera: Some((0, 10_000)), injector: None });
        }
    });
    Ok((server, pulsing, start))
}

async fn connect(address: Ipv4Addr, settings: &GigeSettings) -> Result<GigeCamera, DriverError> {
    let mut camera = GigeCamera::open(&address.to_string(), settings).await?;
    prepare(&mut camera).await?;
    Ok(camera)
}

async fn prepare(camera: &mut GigeCamera) -> Result<(), DriverError> {
    let settings = CameraSettings { rows: ROWS, columns: COLUMNS, integration_s: 25e-6, bits: 14 };
    camera.prepare(&settings).await?;
    camera.start().await
}

/// Takes frames at a rate and counts what is missing or wrong.
async fn stream(address: Ipv4Addr, settings: &GigeSettings, hz: f64, frames: usize) -> Result<Run, String> {
    let words = |error: DriverError| error.to_string();
    let (server, pulsing, _) = serve(address, hz).await?;
    let mut camera = connect(address, settings).await.map_err(words)?;
    let first = camera.frame(DEADLINE).await.map_err(words)?;
    let begun = Instant::now();
    let (mut last, mut lost) = (first.id, 0);
    for _ in 0..frames {
        let frame = camera.frame(DEADLINE).await.map_err(words)?;
        let gap = frame.id.saturating_sub(last + 1);
        lost += usize::try_from(gap).unwrap_or(usize::MAX) + usize::from(!is_whole(&frame));
        last = frame.id;
    }
    let seconds = begun.elapsed().as_secs_f64();
    camera.stop().await.map_err(words)?;
    drop(camera);
    pulsing.abort();
    server.stop().await;
    Ok(Run { seconds, lost, frames })
}

/// Whether the picture is complete and its first and last rows are of one exposure of the pattern.
fn is_whole(frame: &Frame) -> bool {
    let first = u64::from(frame.counts[0]);
    let counts = &frame.counts;
    frame.complete
        && (0..7192_u64).step_by(3).any(|shift| {
            let id = shift / 3;
            u64::from(pattern_count(id, 0, 0)) == first
                && counts[ROWS * COLUMNS - 1] == pattern_count(id, ROWS - 1, COLUMNS - 1)
        })
}

/// From the trigger's pulse until the frame is in the driver's hands, and in the journal on the disk.
async fn latency(address: Ipv4Addr, folder: &Path) -> Result<Vec<Figure>, String> {
    const SHOTS: u32 = 200;
    let words = |error: DriverError| error.to_string();
    let sample = samples::open(Path::new("quickstart"))?;
    let config = Config::parse(&sample.name, &sample.text).map_err(|error| error.to_string())?;
    let plan = Plan::of_map(&config);
    let program = plan.levels[0].program.clone();
    let reduced = Reduced::new(plan, ROWS, COLUMNS, 16_383).map_err(|error| error.to_string())?;
    let root = folder.join(format!(".ditd-bench-wires-{}", std::process::id()));
    std::fs::create_dir_all(root.join("frames")).map_err(|error| format!("{}: {error}", root.display()))?;
    let ended = async {
        let mut recorder =
            Recorder::create(&root, reduced, ROWS, COLUMNS).map_err(|error| error.to_string())?;
        let record = Record::Burst { level: 0, program, first_cycle: 0, shutter_k: None };
        recorder.record(0, record).map_err(|error| error.to_string())?;
        let (server, pulsing, start) = serve(address, 50.0).await?;
        let mut camera = connect(address, &GigeSettings::default()).await.map_err(words)?;
        let (mut to_us, mut to_disk) = (Vec::new(), Vec::new());
        for cycle in 0..SHOTS {
            let frame = camera.frame(DEADLINE).await.map_err(words)?;
            let since = |now: Duration| now.as_secs_f64() - frame.device_ns as f64 * 1e-9;
            to_us.push(since(start.elapsed()));
            let label = Label { level: 0, cycle, position: 0, shot: ShotKind::Blank, shutter: false };
            recorder.frame(u64::from(cycle), label, &frame).map_err(|error| error.to_string())?;
            to_disk.push(since(start.elapsed()));
        }
        camera.stop().await.map_err(words)?;
        pulsing.abort();
        server.stop().await;
        Ok((to_us, to_disk))
    }
    .await;
    // What was written for the figure only.
    let _ = std::fs::remove_dir_all(&root);
    let (to_us, to_disk): (Vec<f64>, Vec<f64>) = ended.map_err(|why: String| why)?;
    let median = |mut times: Vec<f64>| {
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    };
    Ok(vec![
        figure("trigger to frame in hand, median", median(to_us), 0.0, "frames lost", 1),
        figure("trigger to frame in journal, median", median(to_disk), 0.0, "frames lost", 1),
    ])
}

/// The camera is switched off and on again: from there until its first frame.
async fn reconnect(address: Ipv4Addr) -> Result<Figure, String> {
    let words = |error: DriverError| error.to_string();
    let (server, pulsing, _) = serve(address, 100.0).await?;
    let settings = GigeSettings { reconnect_s: 60.0, ..GigeSettings::default() };
    let mut camera = connect(address, &settings).await.map_err(words)?;
    camera.frame(DEADLINE).await.map_err(words)?;
    pulsing.abort();
    server.stop().await;
    loop {
        match camera.frame(DEADLINE).await {
            Ok(_) => {}
            Err(DriverError::Silent { .. }) => {
                if camera.check().await.is_err() {
                    break;
                }
            }
            Err(_) => break,
        }
    }
    let back = tokio::spawn(async move {
        sleep(Duration::from_secs(2)).await;
        serve(address, 100.0).await.map(|(server, pulsing, _)| (server, pulsing, Instant::now()))
    });
    prepare(&mut camera).await.map_err(words)?;
    camera.frame(DEADLINE).await.map_err(words)?;
    let there = Instant::now();
    let (server, pulsing, since) = back.await.map_err(|error| error.to_string())??;
    let seconds = there.saturating_duration_since(since).as_secs_f64();
    drop(camera);
    pulsing.abort();
    server.stop().await;
    Ok(figure("camera switched on again to its first frame", seconds, 0.0, "none", 1))
}
