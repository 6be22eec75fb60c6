//! The simulated rig behind real lines: pseudo-terminals, TCP ports and a GigE Vision camera, in real time.
//!
//! Serves each instrument at the address under which the campaign file looks for it, so that one file is both the rig and
//! the campaign: `serial:PATH` becomes a link to a pseudo-terminal, `tcp:host:port` a listener, a GigE camera a device on a
//! loopback address. Who talks to them cannot know that nothing is there.

use super::{OpenError, simulate_plate, simulate_sensors, simulate_trigger};
use crate::campaign::{StopFlag, Wish};
use crate::config::{Config, SIMULATED};
use ditd_drivers::wire::ByteStream;
use ditd_sim::rig::camera::{SimCamera, WorldState, device_zero_ns};
use ditd_sim::rig::chamber::World;
use ditd_sim::rig::gige::{GigeCamera, GigeServer, GigeStats, Sensor};
use ditd_sim::rig::plate::Plate;
use serde::Serialize;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

/// Trigger pulses on their way to the camera; when full, the trigger unit waits.
const PULSES_MAX: usize = 16;

/// Bytes between a TCP connection and the instrument behind it.
const PIPE_BYTES: usize = 4096;

/// How often a terminal is opened to the next client.
const UNMARK_EVERY: Duration = Duration::from_secs(1);

/// Whose tasks hold the clients' ends.
const HOLDER: &str = "holder";

/// The stop wish is looked at this often.
const WISH_POLL: Duration = Duration::from_millis(100);

/// An instrument and where it can be reached.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Served {
    /// `plate`, `trigger`, `camera` or `monitor`.
    pub instrument: &'static str,
    /// The address in the campaign file.
    pub address: String,
    /// What is behind it.
    pub behind: String,
}

/// A simulated rig on its lines; it goes when this is dropped.
pub struct ServedRig {
    /// What is served.
    pub served: Vec<Served>,
    camera: Option<GigeServer>,
    tasks: Vec<(&'static str, JoinHandle<()>)>,
    links: Vec<Link>,
}

impl ServedRig {
    /// What the camera's network side has done; `None` when no camera is served.
    pub fn camera_stats(&self) -> Option<GigeStats> {
        self.camera.as_ref().map(GigeServer::stats)
    }

    /// Pulls the plug of an instrument's line, for good: `plate` or `trigger`. What it was doing it goes on with only if
    /// it needs no line for it.
    pub fn unplug(&self, instrument: &str) {
        self.tasks.iter().filter(|(name, _)| *name == instrument).for_each(|(_, task)| task.abort());
    }

    /// Serves until the operator wishes otherwise; returns what the camera's network side has done.
    pub async fn until_stopped(self, stop: &StopFlag) -> Option<GigeStats> {
        while stop.wish() == Wish::GoOn {
            sleep(WISH_POLL).await;
        }
        let stats = self.camera_stats();
        if let Some(camera) = self.camera {
            camera.stop().await;
        }
        self.tasks.iter().for_each(|(_, task)| task.abort());
        drop(self.links);
        stats
    }
}

/// Puts every instrument whose address is a real one on its line. Must run inside a tokio runtime with real time.
///
/// # Errors
///
/// [`OpenError`] naming the address that cannot be served and what to try.
pub async fn serve(
    config: &Config,
    world: Arc<World>,
    log: impl Fn(&str) + Send + Sync + 'static,
) -> Result<ServedRig, OpenError> {
    let rig = config.rig.as_ref().ok_or_else(|| {
        OpenError::Config("sim serve: the campaign file has no [rig] table to simulate".to_owned())
    })?;
    let start = Instant::now();
    let mut ours = ServedRig { served: Vec::new(), camera: None, tasks: Vec::new(), links: Vec::new() };
    let (pulses, received) = mpsc::channel(PULSES_MAX);
    let trigger = &config.trigger;
    if let Some((stream, behind)) = ours.line("trigger", &trigger.address).await? {
        let task = simulate_trigger(&trigger.driver, rig, stream, pulses.clone(), start)?;
        ours.tasks.push(("trigger", task));
        ours.note("trigger", &trigger.address, behind);
    }
    let plate = Arc::new(Mutex::new(Plate::new(rig.plate.clone(), config.campaign.seed)));
    if let Some((stream, behind)) = ours.line("plate", &config.plate.address).await? {
        let task = simulate_plate(&config.plate.driver, rig, stream, Arc::clone(&plate), start)?;
        ours.tasks.push(("plate", task));
        ours.note("plate", &config.plate.address, behind);
    }
    for monitor in config.monitors.iter().filter(|monitor| monitor.driver == "ascii_query") {
        if let Some((stream, behind)) = ours.line("monitor", &monitor.address).await? {
            let task = simulate_sensors(rig, stream, config.campaign.seed, start);
            ours.tasks.push(("monitor", task));
            ours.note("monitor", &monitor.address, behind);
        }
    }
    if config.camera.address != SIMULATED {
        let address: Ipv4Addr = config.camera.address.parse().map_err(|_| {
            OpenError::Config(format!(
                "sim serve: camera.address = {:?} is no IPv4 address; a simulated camera wants one of its own on loopback, \
                 such as 127.0.0.21",
                config.camera.address
            ))
        })?;
        if !address.is_loopback() {
            return Err(OpenError::Config(format!(
                "sim serve: camera.address = {address} is not on loopback (127.x.x.x): a simulated camera is not put on a real network"
            )));
        }
        let seed = config.campaign.seed;
        let sensor = Sensor {
            rows: side(config.camera.rows),
            columns: side(config.camera.columns),
            bits: config.camera.bits,
            shutter: rig.detector.shutter_temperature_k.is_some(),
        };
        let surface = move |now_s: f64| {
            let mut plate = plate.lock().unwrap_or_else(PoisonError::into_inner);
            plate.advance(now_s);
            plate.surface_k()
        };
        let behind = SimCamera::switch_on(
            world,
            Box::new(surface),
            rig.faults.clone(),
            WorldState::default(),
            received,
        );
        let server = GigeCamera::new(Box::new(behind), sensor)
            .preset(rig.gige.preset)
            .faults(rig.gige.faults.clone(), seed)
            .clock(start, device_zero_ns(seed))
            .pulses(pulses)
            .log(log)
            .serve(address)
            .await
            .map_err(|error| OpenError::Config(format!("sim serve: {error}")))?;
        ours.note("camera", &config.camera.address, format!("GigE Vision at {}", server.address()));
        ours.camera = Some(server);
    }
    if ours.served.is_empty() {
        return Err(OpenError::Config(
            "sim serve: every address is \"sim\": such a rig needs no lines. Give serial:PATH, tcp:127.0.0.1:PORT or a loopback \
             address of a GigE camera."
                .to_owned(),
        ));
    }
    Ok(ours)
}

fn side(pixels: usize) -> u32 {
    u32::try_from(pixels).unwrap_or(u32::MAX)
}

impl ServedRig {
    fn note(&mut self, instrument: &'static str, address: &str, behind: String) {
        self.served.push(Served { instrument, address: address.to_owned(), behind });
    }

    /// The instrument's end of a line; `None` for an instrument that has none.
    async fn line(
        &mut self,
        instrument: &'static str,
        address: &str,
    ) -> Result<Option<(Box<dyn ByteStream>, String)>, OpenError> {
        let wrong = |why: String| OpenError::Config(format!("sim serve: {address}: {why}"));
        match address.split_once(':') {
            None if address == SIMULATED => Ok(None),
            Some(("serial", path)) => {
                let Terminal { far, near, name } =
                    pseudo_terminal().map_err(|error| wrong(error.to_string()))?;
                self.tasks.push((HOLDER, tokio::spawn(hold(near))));
                self.links.push(Link::make(Path::new(path), Path::new(&name)).map_err(wrong)?);
                Ok(Some((far, format!("pseudo-terminal {name}"))))
            }
            Some(("tcp", peer)) => {
                let listener = TcpListener::bind(peer).await.map_err(|error| wrong(error.to_string()))?;
                let local = listener.local_addr().map_err(|error| wrong(error.to_string()))?;
                if !local.ip().is_loopback() {
                    return Err(wrong(
                        "not on loopback: a simulated instrument is not put on a real network".to_owned(),
                    ));
                }
                let (near, far) = tokio::io::duplex(PIPE_BYTES);
                self.tasks.push((instrument, tokio::spawn(pump(listener, near))));
                Ok(Some((Box::new(far), format!("listening at {local}"))))
            }
            _ => Err(wrong("no line can be simulated there: serial:PATH or tcp:127.0.0.1:PORT".to_owned())),
        }
    }
}

/// One connection after the other to the same instrument. Its own side stays open between them: it is not switched off when
/// a client hangs up.
async fn pump(listener: TcpListener, mut near: tokio::io::DuplexStream) {
    while let Ok((peer, _)) = listener.accept().await {
        if !carry(peer, &mut near).await {
            return;
        }
    }
}

/// Carries bytes both ways until the client has gone; false when the instrument has.
async fn carry(mut peer: TcpStream, near: &mut tokio::io::DuplexStream) -> bool {
    let (mut said, mut answered) = ([0; 256], [0; 256]);
    loop {
        tokio::select! {
            read = peer.read(&mut said) => match read {
                Ok(0) | Err(_) => return true,
                Ok(count) => {
                    if near.write_all(&said[..count]).await.is_err() {
                        return false;
                    }
                }
            },
            read = near.read(&mut answered) => match read {
                Ok(0) | Err(_) => return false,
                Ok(count) => {
                    if peer.write_all(&answered[..count]).await.is_err() {
                        return true;
                    }
                }
            },
        }
    }
}

/// A pseudo-terminal.
struct Terminal {
    /// The instrument's end.
    far: Box<dyn ByteStream>,
    /// The client's end, which must be held.
    near: Held,
    /// The name of the client's end.
    name: String,
}

/// A new pseudo-terminal.
#[cfg(unix)]
fn pseudo_terminal() -> Result<Terminal, Box<dyn std::error::Error>> {
    use rustix::fs::{Mode, OFlags};
    use tokio_serial::{SerialPort, SerialStream};
    let (far, near) = SerialStream::pair()?;
    let name = near.name().ok_or("the pseudo-terminal has no name")?;
    let held = rustix::fs::open(&name, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
    Ok(Terminal { far: Box::new(far), near: held, name })
}

#[cfg(unix)]
type Held = std::os::fd::OwnedFd;

#[cfg(not(unix))]
type Held = ();

#[cfg(not(unix))]
fn pseudo_terminal() -> Result<Terminal, Box<dyn std::error::Error>> {
    Err("this system has no pseudo-terminals: use tcp:127.0.0.1:PORT".into())
}

/// Holds the client's end open, so that it may come and go: once nobody has it open the instrument's end reports a hang-up
/// that tokio never forgets, and reads in a circle. A client leaves the terminal marked as exclusive, which would shut an
/// ordinary user's next one out: the mark is taken away.
#[cfg(unix)]
async fn hold(near: Held) {
    loop {
        // Fails only on terminals that know no such mark.
        let _ = rustix::termios::ioctl_tiocnxcl(&near);
        sleep(UNMARK_EVERY).await;
    }
}

#[cfg(not(unix))]
async fn hold((): Held) {}

/// A link to a pseudo-terminal; it goes when this is dropped.
#[derive(Debug)]
struct Link {
    at: PathBuf,
    to: PathBuf,
}

impl Link {
    /// Makes the link, and takes the place of one that leads nowhere any more.
    #[cfg(unix)]
    fn make(at: &Path, to: &Path) -> Result<Self, String> {
        if let Some(folder) = at.parent() {
            std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        }
        if at.is_symlink() && !at.exists() || is_pseudo_terminal(at) {
            std::fs::remove_file(at).map_err(|error| error.to_string())?;
        }
        std::os::unix::fs::symlink(to, at).map_err(|error| {
            format!("{error}. Choose a path where nothing is, such as /tmp/ditd-wires/plate")
        })?;
        Ok(Self { at: at.to_owned(), to: to.to_owned() })
    }

    #[cfg(not(unix))]
    fn make(_: &Path, _: &Path) -> Result<Self, String> {
        Err("this system has no pseudo-terminals".to_owned())
    }
}

/// A link that an earlier one of these left behind: it was killed, and the number of its terminal may be in use again.
fn is_pseudo_terminal(at: &Path) -> bool {
    std::fs::read_link(at).is_ok_and(|to| to.starts_with("/dev/pts"))
}

impl Drop for Link {
    fn drop(&mut self) {
        if std::fs::read_link(&self.at).is_ok_and(|to| to == self.to) {
            // Nobody to tell: it leads nowhere, and the next one takes its place.
            let _ = std::fs::remove_file(&self.at);
        }
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    /// Real sockets on loopback: the instrument is there for the second client, too.
    #[tokio::test]
    async fn a_client_that_hangs_up_does_not_switch_the_instrument_off() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let at = listener.local_addr().unwrap();
        let (near, mut far) = tokio::io::duplex(PIPE_BYTES);
        tokio::spawn(pump(listener, near));
        let instrument = tokio::spawn(async move {
            let mut heard = [0; 4];
            for _ in 0..2 {
                far.read_exact(&mut heard).await.unwrap();
                far.write_all(b"24.091").await.unwrap();
            }
        });
        for _ in 0..2 {
            let mut client = TcpStream::connect(at).await.unwrap();
            client.write_all(b"ask?").await.unwrap();
            let mut answer = [0; 6];
            client.read_exact(&mut answer).await.unwrap();
            assert_eq!(&answer, b"24.091");
        }
        instrument.await.unwrap();
    }

    #[test]
    fn a_link_takes_the_place_of_a_dead_one_and_of_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path().join("wires/plate");
        let link = Link::make(&at, Path::new("/dev/pts/9999")).unwrap();
        let again = Link::make(&at, Path::new("/dev/pts/9998")).unwrap();
        drop(link);
        assert!(at.is_symlink(), "the later one is not ours to take away");
        drop(again);
        assert!(!at.is_symlink());
        std::fs::write(&at, b"somebody's").unwrap();
        assert!(Link::make(&at, Path::new("/dev/pts/9997")).unwrap_err().contains("where nothing is"));
        assert_eq!(std::fs::read(&at).unwrap(), b"somebody's");
    }
}
