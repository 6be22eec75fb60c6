//! A camera with a test pattern on the network, for trying clients and drivers by hand.
//!
//! `cargo run --release --example gige_camera -- 127.0.0.2 --preset flir --fault '{"kind":"packet-loss","probability":0.01}'`
//!
//! Options: `--preset generic|flir|telops`, `--rows N`, `--columns N`, `--seed N`, `--external-hz F` (a trigger unit on
//! its input that pulses all the time), `--fault JSON` (several), `--initial FEATURE=VALUE` (several), `--cool-down S`,
//! `--seconds N` (default: until killed). The frame rate when not triggered is the client's to set. What it has done is
//! written every two seconds.

use ditd_sim::rig::gige::pattern::PatternCamera;
use ditd_sim::rig::gige::{GigeCamera, GigeFault, Preset, Sensor};
use ditd_sim::rig::pulse::Pulse;
use std::io::Write;
use std::net::Ipv4Addr;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, interval, sleep_until};

type Failure = Box<dyn std::error::Error>;

struct Options {
    address: Ipv4Addr,
    preset: Preset,
    rows: u32,
    columns: u32,
    seed: u64,
    external_hz: Option<f64>,
    faults: Vec<GigeFault>,
    initial: Vec<(String, f64)>,
    cool_down_s: f64,
    seconds: u64,
}

fn options() -> Result<Options, Failure> {
    let mut options = Options {
        address: Ipv4Addr::new(127, 0, 0, 2),
        preset: Preset::Generic,
        rows: 512,
        columns: 640,
        seed: 1,
        external_hz: None,
        faults: Vec::new(),
        initial: Vec::new(),
        cool_down_s: 0.0,
        seconds: u64::MAX,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        if !word.starts_with("--") {
            options.address = word.parse()?;
            continue;
        }
        let value = words.next().ok_or_else(|| format!("{word} needs a value"))?;
        match word.as_str() {
            "--preset" => options.preset = serde_json::from_value(value.into())?,
            "--rows" => options.rows = value.parse()?,
            "--columns" => options.columns = value.parse()?,
            "--seed" => options.seed = value.parse()?,
            "--external-hz" => options.external_hz = Some(value.parse()?),
            "--fault" => options.faults.push(serde_json::from_str(&value)?),
            "--initial" => {
                let (name, number) = value.split_once('=').ok_or("--initial FEATURE=VALUE")?;
                options.initial.push((name.to_owned(), number.parse()?));
            }
            "--cool-down" => options.cool_down_s = value.parse()?,
            "--seconds" => options.seconds = value.parse()?,
            _ => return Err(format!("unknown option {word}").into()),
        }
    }
    Ok(options)
}

/// A trigger unit that pulses the camera all the time.
async fn pulse(hz: f64, pulses: mpsc::Sender<Pulse>, start: Instant) {
    for t0_index in 0_u64.. {
        let at = Duration::from_secs_f64(t0_index as f64 / hz);
        sleep_until(start + at).await;
        let at_ns = u64::try_from(at.as_nanos()).unwrap_or(u64::MAX);
        // Nobody takes them while the camera is stopped.
        let _ = pulses.try_send(Pulse { t0_index, at_ns, camera: Some((0, 10_000)), injector: None });
    }
}

async fn serve(options: Options) -> Result<(), Failure> {
    let (pulses, taken) = mpsc::channel(8);
    let camera = PatternCamera::new(options.rows as usize, options.columns as usize, 14, taken);
    let sensor = Sensor { rows: options.rows, columns: options.columns, bits: 14, shutter: true };
    let start = Instant::now();
    let mut camera = GigeCamera::new(Box::new(camera), sensor)
        .preset(options.preset)
        .pulses(pulses.clone())
        .clock(start, 0)
        .faults(options.faults, options.seed)
        .cool_down(Duration::from_secs_f64(options.cool_down_s))
        .log(|message| {
            // Nothing is to be done about a closed terminal.
            let _ = writeln!(std::io::stderr(), "{message}");
        });
    for (name, value) in options.initial {
        camera = camera.initial(&name, value);
    }
    let server = camera.serve(options.address).await?;
    let mut out = std::io::stderr();
    writeln!(out, "camera at {}", server.address())?;
    if let Some(hz) = options.external_hz {
        tokio::spawn(pulse(hz, pulses, start));
    }
    let mut seconds = 0;
    let mut every = interval(Duration::from_secs(2));
    let mut before = server.stats();
    while seconds < options.seconds {
        every.tick().await;
        seconds += 2;
        let stats = server.stats();
        if stats != before {
            writeln!(out, "{}", serde_json::to_string(&stats)?)?;
        }
        before = stats;
    }
    Ok(())
}

fn main() -> Result<(), Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(serve(options()?))
}
