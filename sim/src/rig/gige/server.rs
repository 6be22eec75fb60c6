//! Puts a camera on the network: the owner's side (builder, handle).
//!
//! Binds exactly one address, never all interfaces. Needs a tokio runtime with real time and `net`; the camera behind
//! may live on the same one. Nothing here knows a register or a packet.

use super::control::{Clock, Control};
use super::device::Device;
use super::fault::{Faults, GigeFault};
use super::gvcp;
use super::outlet::{Late, Outlet, Ring};
use super::presets::{Preset, Sensor};
use super::profile::Profile;
use super::stats::{GigeStats, Shared};
use super::stream::{Flags, Log, Pulser, Streamer};
use crate::rig::RigError;
use crate::rig::pulse::Pulse;
use ditd_drivers::instrument::{Camera, Identity};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;
use tokio::net::UdpSocket;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio::time::Instant;

/// Orders and reports that wait between control and stream.
const QUEUED_MAX: usize = 16;

/// A camera to be put on the network.
pub struct GigeCamera {
    camera: Box<dyn Camera>,
    sensor: Sensor,
    preset: Preset,
    identity: Option<Identity>,
    pulses: Option<mpsc::Sender<Pulse>>,
    clock: Option<Clock>,
    faults: Vec<GigeFault>,
    seed: u64,
    cool_down: Duration,
    initial: Vec<(String, f64)>,
    log: Log,
}

impl GigeCamera {
    /// A camera by the book before `camera`, whose detector is `sensor`; the region of interest is cut here, since a
    /// [`Camera`] knows no offsets.
    pub fn new(camera: Box<dyn Camera>, sensor: Sensor) -> Self {
        Self {
            camera,
            sensor,
            preset: Preset::Generic,
            identity: None,
            pulses: None,
            clock: None,
            faults: Vec::new(),
            seed: 0,
            cool_down: Duration::ZERO,
            initial: Vec::new(),
            log: Arc::new(|_| {}),
        }
    }

    /// Another make.
    pub fn preset(self, preset: Preset) -> Self {
        Self { preset, ..self }
    }

    /// Other names than the camera's own.
    pub fn identity(self, identity: Identity) -> Self {
        Self { identity: Some(identity), ..self }
    }

    /// Where the camera's own triggers (free run, software) go. Without it only an external trigger makes frames.
    pub fn pulses(self, pulses: mpsc::Sender<Pulse>) -> Self {
        Self { pulses: Some(pulses), ..self }
    }

    /// The clock whose zero is the rig's start, and what the camera's own clock showed then, in nanoseconds. Without it
    /// the clock starts at 0 with the camera.
    pub fn clock(self, start: Instant, zero_ns: u64) -> Self {
        Self { clock: Some(Clock { start, zero_ns }), ..self }
    }

    /// Faults to play.
    pub fn faults(self, faults: Vec<GigeFault>, seed: u64) -> Self {
        Self { faults, seed, ..self }
    }

    /// How long cooler and sensor need after switching on; until then the stream cannot be started (BUSY).
    pub fn cool_down(self, cool_down: Duration) -> Self {
        Self { cool_down, ..self }
    }

    /// A feature that starts with another value than the make's, for instance `("IRFormat", 2.0)`.
    pub fn initial(mut self, feature: &str, value: f64) -> Self {
        self.initial.push((feature.to_owned(), value));
        self
    }

    /// Where messages for the operator go: camera errors, loss of control.
    pub fn log(self, log: impl Fn(&str) + Send + Sync + 'static) -> Self {
        Self { log: Arc::new(log), ..self }
    }

    /// Switches it on at `address`, on the standard's port 3956. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// [`RigError::Config`] for an impossible fault, sensor or initial value; [`RigError::Network`] when the address is
    /// not a single one, the port is taken, or the camera does not say who it is.
    pub async fn serve(self, address: Ipv4Addr) -> Result<GigeServer, RigError> {
        self.serve_at(SocketAddrV4::new(address, gvcp::PORT)).await
    }

    /// The same on another port: clients find it only if they are told; 0 takes a free one.
    ///
    /// # Errors
    /// As [`GigeCamera::serve`].
    pub async fn serve_at(mut self, at: SocketAddrV4) -> Result<GigeServer, RigError> {
        self.faults.iter().try_for_each(GigeFault::check).map_err(|why| config("camera.fault", why))?;
        let address = *at.ip();
        if address.is_unspecified() || address.is_broadcast() || address.is_multicast() {
            return Err(config("camera.address", format!("{address} is not the address of one interface")));
        }
        let identity = match self.identity.take() {
            Some(identity) => identity,
            None => self.camera.identify().await.map_err(|error| RigError::Network {
                doing: "asking the camera who it is".to_owned(),
                why: error.to_string(),
                hint: "Check the camera behind.".to_owned(),
            })?,
        };
        let (socket, stream) = (bind(at).await?, bind(SocketAddrV4::new(address, 0)).await?);
        let profile = Profile {
            preset: self.preset,
            sensor: self.sensor,
            identity,
            address,
            stream_port: port_of(&stream)?,
            cool_down_ns: u64::try_from(self.cool_down.as_nanos()).unwrap_or(u64::MAX),
            initial: std::mem::take(&mut self.initial),
        };
        profile.check().map_err(|why| config("camera", why))?;
        let port = port_of(&socket)?;
        Ok(self.spawn(profile, Arc::new(socket), Arc::new(stream), SocketAddrV4::new(address, port)))
    }

    fn spawn(
        self,
        profile: Profile,
        socket: Arc<UdpSocket>,
        stream: Arc<UdpSocket>,
        address: SocketAddrV4,
    ) -> GigeServer {
        let clock = self.clock.unwrap_or_else(|| Clock { start: Instant::now(), zero_ns: 0 });
        let stats = Shared::default();
        let faults = Arc::new(Faults::new(self.faults, self.seed));
        let (orders, orders_taken) = mpsc::channel(QUEUED_MAX);
        let (reports_made, reports) = mpsc::channel(QUEUED_MAX);
        let late = Late::new();
        let outlet =
            Outlet { socket: stream, faults: Arc::clone(&faults), stats: stats.clone(), late: late.clone() };
        let ring = Ring::default();
        let flags = Flags::default();
        let made = Arc::new(AtomicU64::new(0));
        let pulser = Pulser { pulses: self.pulses, start: clock.start, made, stats: stats.clone() };
        let streamer = Streamer {
            camera: self.camera,
            orders: orders_taken,
            reports: reports_made,
            outlet: outlet.clone(),
            ring: ring.clone(),
            pulser: pulser.clone(),
            flags: flags.clone(),
            log: Arc::clone(&self.log),
            frames: 0,
            runs: 0,
        };
        let device = Device::new(profile, clock.raw_ns());
        let control = Control::new(device, socket, clock, orders, outlet, ring, pulser, flags, self.log);
        let (off, switched_off) = oneshot::channel();
        let control = tokio::spawn(control.live(reports, switched_off));
        let camera = tokio::spawn(streamer.live());
        GigeServer { address, stats, faults, off: Some(off), control, camera: Some(camera) }
    }
}

fn config(key: &str, why: String) -> RigError {
    RigError::Config { key: key.to_owned(), why }
}

async fn bind(at: SocketAddrV4) -> Result<UdpSocket, RigError> {
    UdpSocket::bind(at).await.map_err(|error| RigError::Network {
        doing: format!("opening the camera's port at {at}"),
        why: error.to_string(),
        hint:
            "Choose an address of this machine on which no other camera is simulated, for instance 127.0.0.9."
                .to_owned(),
    })
}

fn port_of(socket: &UdpSocket) -> Result<u16, RigError> {
    socket.local_addr().as_ref().map(SocketAddr::port).map_err(|error| RigError::Network {
        doing: "asking for the port".to_owned(),
        why: error.to_string(),
        hint: "Try again.".to_owned(),
    })
}

/// A camera on the network. It is switched off when this is dropped.
pub struct GigeServer {
    address: SocketAddrV4,
    stats: Shared,
    faults: Arc<Faults>,
    off: Option<oneshot::Sender<()>>,
    control: JoinHandle<()>,
    camera: Option<JoinHandle<Box<dyn Camera>>>,
}

impl GigeServer {
    /// Where the control channel listens.
    pub fn address(&self) -> SocketAddrV4 {
        self.address
    }

    /// What it has done so far.
    pub fn stats(&self) -> GigeStats {
        self.stats.read()
    }

    /// Plays these faults from now on, and no longer the earlier ones; none: all is well again. Frames go on being counted
    /// from switching on ([`GigeStats::frames`]).
    ///
    /// # Errors
    /// [`RigError::Config`] for a fault that cannot be played; the earlier ones go on.
    pub fn play(&self, faults: Vec<GigeFault>) -> Result<(), RigError> {
        faults.iter().try_for_each(GigeFault::check).map_err(|why| config("camera.fault", why))?;
        self.faults.replace(faults);
        Ok(())
    }

    /// Switches it off and gives the camera behind back, stopped; `None` when its task has died.
    pub async fn stop(mut self) -> Option<Box<dyn Camera>> {
        self.off = None;
        // The control side ends by itself, and the stream's side after it.
        self.camera.take()?.await.ok()
    }
}

impl Drop for GigeServer {
    fn drop(&mut self) {
        if let Some(camera) = &self.camera {
            camera.abort();
            self.control.abort();
        }
    }
}
