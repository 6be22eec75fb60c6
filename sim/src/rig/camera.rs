//! The simulated camera: waits for trigger pulses, exposes the world, hands out frames.
//!
//! A task on tokio's clock; it never reads a clock itself, times come with the pulses. The heavy part of a frame
//! runs as a blocking job that is awaited before the next pulse is taken, so that virtual time cannot run ahead.
//! When the queue of finished frames is full the task waits, and with it the trigger unit that feeds it. Knows
//! nothing of plans or levels.

use super::chamber::{Moment, ResidualVapour, Target, World};
use super::config::Fault;
use super::detector::Exposure;
use super::level::Illumination;
use super::noise::{Purpose, Stream};
use super::pulse::Pulse;
use async_trait::async_trait;
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{Camera, CameraClock, CameraSettings, Frame, Identity};
use ditd_drivers::quantity::Kelvin;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::Instant;

/// Finished frames that wait to be fetched: 5.2 MB at 640 × 512 pixels of two bytes. When full, the task waits.
pub const FRAMES_QUEUED_MAX: usize = 8;

/// Pixels below which a frame is made in place: it takes less time than handing it to another thread.
const PIXELS_IN_PLACE_MAX: usize = 4096;

/// Grain of the integration time, in seconds.
const INTEGRATION_GRAIN_S: f64 = 1e-7;

/// Shortest and longest integration time, in seconds: 1 µs is the assumed camera's; the longest is its frame time
/// at 100 Hz.
const INTEGRATION_LIMITS_S: [f64; 2] = [1e-6, 1e-2];

/// The plate's true surface temperature as the light in the world follows it.
pub trait PlateSurface: Send {
    /// Surface temperature in kelvin at `now_s` seconds after the rig's start; times do not decrease.
    fn surface_k_at(&mut self, now_s: f64) -> f64;
}

impl<F: FnMut(f64) -> f64 + Send> PlateSurface for F {
    fn surface_k_at(&mut self, now_s: f64) -> f64 {
        self(now_s)
    }
}

/// What the world before the camera remembers between frames: enough to go on with the same bits.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct WorldState {
    /// Exposures so far: the id of the next frame and the key of its noise.
    pub exposures: u64,
    /// Injections so far: the key of the next one's fields.
    pub injections: u64,
    /// Vapour that injections have left.
    pub vapour: ResidualVapour,
    /// Start of the last exposure, in nanoseconds since the rig's start.
    pub last_exposure_ns: Option<u64>,
    /// Frames since the last pause at the last exposure.
    pub since_pause: u32,
}

/// A simulated camera.
#[derive(Debug)]
pub struct SimCamera {
    shared: Arc<Shared>,
    frames: mpsc::Receiver<Queued>,
    /// Zero of the rig's clock, where the camera was told of it.
    start: Option<Instant>,
    /// Ends with the camera.
    task: JoinHandle<()>,
}

/// What driver and task both see.
#[derive(Debug)]
struct Shared {
    world: Arc<World>,
    orders: Mutex<Orders>,
    state: Mutex<WorldState>,
}

/// What the driver has ordered.
#[derive(Debug, Clone, Copy)]
struct Orders {
    integration_s: Option<f64>,
    running: bool,
    shutter_closed: bool,
    /// Counts starts: frames of an earlier run are dropped.
    run: u64,
}

#[derive(Debug)]
struct Queued {
    run: u64,
    frame: Frame,
}

impl SimCamera {
    /// Switches a camera on. It lives until it is dropped or the trigger unit's side of `pulses` is.
    ///
    /// `state` is the world's memory, [`WorldState::default`] for a fresh rig. Must be called within a tokio
    /// runtime.
    pub fn switch_on(
        world: Arc<World>,
        plate: Box<dyn PlateSurface>,
        faults: Vec<Fault>,
        state: WorldState,
        pulses: mpsc::Receiver<Pulse>,
    ) -> Self {
        let orders = Orders { integration_s: None, running: false, shutter_closed: false, run: 0 };
        let shared = Arc::new(Shared { world, orders: Mutex::new(orders), state: Mutex::new(state) });
        let (sender, frames) = mpsc::channel(FRAMES_QUEUED_MAX);
        let body = Body { shared: Arc::clone(&shared), plate, faults, sender, stuck_in_run: None };
        Self { shared, frames, start: None, task: tokio::spawn(body.live(pulses)) }
    }

    /// The same camera, which can tell what its clock shows: the rig's clock began at `start`.
    #[must_use]
    pub fn clock_from(mut self, start: Instant) -> Self {
        self.start = Some(start);
        self
    }

    /// What the camera's own clock showed at the rig's start, in nanoseconds.
    pub fn clock_zero_ns(&self) -> u64 {
        device_zero_ns(self.shared.world.seed())
    }

    /// What the world remembers now.
    pub fn state(&self) -> WorldState {
        *lock(&self.shared.state)
    }

    /// Puts the world's memory back to an earlier state, as a resumed campaign does.
    pub fn restore(&self, state: WorldState) {
        *lock(&self.shared.state) = state;
    }

    fn refuse<T>(doing: &str, why: String, hint: &str) -> Result<T, DriverError> {
        let (who, doing, hint) = (WHO.to_owned(), doing.to_owned(), hint.to_owned());
        Err(DriverError::Refused { who, doing, why, hint })
    }

    fn halt(&mut self) {
        lock(&self.shared.orders).running = false;
        while self.frames.try_recv().is_ok() {}
    }
}

impl Drop for SimCamera {
    fn drop(&mut self) {
        self.task.abort();
    }
}

const WHO: &str = "simulated camera";

#[async_trait]
impl Camera for SimCamera {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        Ok(Identity {
            maker: "ditd".to_owned(),
            model: "simulated camera".to_owned(),
            serial: format!("{:016x}", self.shared.world.seed()),
            firmware: env!("CARGO_PKG_VERSION").to_owned(),
        })
    }

    async fn prepare(&mut self, settings: &CameraSettings) -> Result<CameraSettings, DriverError> {
        const DOING: &str = "setting region and integration time";
        let world = &self.shared.world;
        let (rows, columns) = (world.sights().rows(), world.sights().columns());
        if (settings.rows, settings.columns) != (rows, columns) {
            let why = format!("{}×{} asked, it has {rows}×{columns}", settings.rows, settings.columns);
            return Self::refuse(DOING, why, "Give the camera and the view of the rig the same size.");
        }
        let bits = world.detector().config().bits;
        if settings.bits != bits {
            let why = format!("{} bits asked, it has {bits}", settings.bits);
            return Self::refuse(DOING, why, "Give camera and detector of the rig the same bits.");
        }
        let [shortest, longest] = INTEGRATION_LIMITS_S;
        if !(shortest..=longest).contains(&settings.integration_s) {
            let why = format!("{} s is not from {shortest} s to {longest} s", settings.integration_s);
            return Self::refuse(DOING, why, "Choose another integration time.");
        }
        let mut orders = lock(&self.shared.orders);
        if orders.running {
            return Self::refuse(DOING, "it is waiting for triggers".to_owned(), "Stop it first.");
        }
        let integration_s = (settings.integration_s / INTEGRATION_GRAIN_S).round() * INTEGRATION_GRAIN_S;
        orders.integration_s = Some(integration_s);
        Ok(CameraSettings { integration_s, ..settings.clone() })
    }

    async fn shutter(&mut self, closed: bool) -> Result<Option<Kelvin>, DriverError> {
        let Some(shutter_k) = self.shared.world.detector().config().shutter_temperature_k else {
            let why = "it has no shutter".to_owned();
            return Self::refuse(
                "moving the shutter",
                why,
                "Put a plate of known temperature before the lens.",
            );
        };
        lock(&self.shared.orders).shutter_closed = closed;
        Ok(closed.then_some(Kelvin(shutter_k)))
    }

    async fn clock(&mut self) -> Result<Option<CameraClock>, DriverError> {
        let now = Instant::now();
        Ok(self.start.map(|start| {
            let since_ns = u64::try_from((now - start).as_nanos()).unwrap_or(u64::MAX);
            let device_ns = self.clock_zero_ns().saturating_add(since_ns);
            CameraClock { device_ns, earliest: now, latest: now }
        }))
    }

    async fn start(&mut self) -> Result<(), DriverError> {
        while self.frames.try_recv().is_ok() {}
        let mut orders = lock(&self.shared.orders);
        if orders.integration_s.is_none() {
            let why = "no integration time was set".to_owned();
            return Self::refuse("starting", why, "Prepare the camera first.");
        }
        orders.running = true;
        orders.run += 1;
        Ok(())
    }

    async fn frame(&mut self, deadline: Duration) -> Result<Frame, DriverError> {
        const DOING: &str = "waiting for a frame";
        let run = lock(&self.shared.orders).run;
        let frames = &mut self.frames;
        let next = async {
            loop {
                match frames.recv().await {
                    Some(queued) if queued.run == run => break Some(queued.frame),
                    Some(_) => {}
                    None => break None,
                }
            }
        };
        match tokio::time::timeout(deadline, next).await {
            Ok(Some(frame)) => Ok(frame),
            Ok(None) => {
                Err(DriverError::lost(WHO, DOING, "the trigger unit was switched off", "Start the rig anew."))
            }
            Err(_) => Err(DriverError::Silent {
                who: WHO.to_owned(),
                doing: DOING.to_owned(),
                waited: deadline,
                tries: 1,
                hint: "Check that the camera is started and the trigger unit runs.".to_owned(),
            }),
        }
    }

    async fn stop(&mut self) -> Result<(), DriverError> {
        self.halt();
        Ok(())
    }

    async fn make_safe(&mut self) -> Result<(), DriverError> {
        self.halt();
        Ok(())
    }
}

/// The task's side: sensor, injector and faults.
struct Body {
    shared: Arc<Shared>,
    plate: Box<dyn PlateSurface>,
    faults: Vec<Fault>,
    sender: mpsc::Sender<Queued>,
    /// The run in which the camera got stuck.
    stuck_in_run: Option<u64>,
}

impl Body {
    async fn live(mut self, mut pulses: mpsc::Receiver<Pulse>) {
        while let Some(pulse) = pulses.recv().await {
            let injection = self.injection_of(&pulse);
            if let Some(queued) = self.expose(&pulse, injection).await
                && self.sender.send(queued).await.is_err()
            {
                return;
            }
            self.remember_injection(&pulse, injection);
        }
    }

    /// Ordinal of the injection in this pulse if fuel really comes.
    fn injection_of(&self, pulse: &Pulse) -> Option<u64> {
        let injection = lock(&self.shared.state).injections;
        let misfires = self.faults.contains(&Fault::Misfire { injection });
        (pulse.injector.is_some() && !misfires).then_some(injection)
    }

    fn remember_injection(&self, pulse: &Pulse, injection: Option<u64>) {
        if pulse.injector.is_none() {
            return;
        }
        let mut state = lock(&self.shared.state);
        state.injections += 1;
        if let (Some(law), Some(_)) = (self.shared.world.residual(), injection) {
            state.vapour.inject(law, pulse.at_ns);
        }
    }

    /// The frame of a pulse; `None` when the camera does not expose or the frame is lost on the way.
    async fn expose(&mut self, pulse: &Pulse, injection: Option<u64>) -> Option<Queued> {
        let (delay_ns, _) = pulse.camera?;
        let orders = *lock(&self.shared.orders);
        let integration_s = orders.integration_s.filter(|_| orders.running)?;
        let ordinal = lock(&self.shared.state).exposures;
        if self.faults.contains(&Fault::Stuck { frame: ordinal }) && self.stuck_in_run.is_none() {
            self.stuck_in_run = Some(orders.run);
        }
        if self.stuck_in_run == Some(orders.run) {
            return None;
        }
        let at_ns = pulse.at_ns + delay_ns;
        let target = match injection {
            _ if orders.shutter_closed => Target::Shutter,
            Some(injection) => Target::Spray { injection },
            None => Target::Blank,
        };
        let moment = self.moment(target, integration_s, at_ns);
        let mut counts = counts_of(Arc::clone(&self.shared.world), moment).await;
        if self.faults.contains(&Fault::LoseFrame { frame: ordinal }) {
            return None;
        }
        let complete = !self.faults.contains(&Fault::IncompleteFrame { frame: ordinal });
        if !complete {
            let half = counts.len() / 2;
            counts[half..].fill(0);
        }
        let sights = self.shared.world.sights();
        let frame = Frame {
            id: ordinal,
            device_ns: at_ns + device_zero_ns(self.shared.world.seed()),
            rows: sights.rows(),
            columns: sights.columns(),
            counts: counts.into(),
            complete,
        };
        Some(Queued { run: orders.run, frame })
    }

    /// Takes stock of the world for an exposure at `at_ns`, and counts it.
    fn moment(&mut self, target: Target, integration_s: f64, at_ns: u64) -> Moment {
        let world = &self.shared.world;
        let at_s = at_ns as f64 * 1e-9;
        let plate_k = self.plate.surface_k_at(at_s);
        let mut state = lock(&self.shared.state);
        let vapour_depth = world.residual().map_or(0.0, |law| state.vapour.depth_at(law, at_ns));
        let idle_s = world.detector().config().warm_up.map_or(f64::INFINITY, |w| w.idle_s);
        let rested =
            state.last_exposure_ns.is_none_or(|last| at_ns.saturating_sub(last) as f64 * 1e-9 > idle_s);
        state.since_pause = if rested { 0 } else { state.since_pause.saturating_add(1) };
        state.last_exposure_ns = Some(at_ns);
        let exposure = Exposure { ordinal: state.exposures, at_s, since_pause: state.since_pause };
        state.exposures += 1;
        Moment { target, light: Illumination { plate_k, integration_s, vapour_depth }, exposure }
    }
}

async fn counts_of(world: Arc<World>, moment: Moment) -> Vec<u16> {
    if world.sights().rows() * world.sights().columns() <= PIXELS_IN_PLACE_MAX {
        return world.expose(&moment);
    }
    match tokio::task::spawn_blocking(move || world.expose(&moment)).await {
        Ok(counts) => counts,
        Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
        // The runtime is shutting down: nobody will look at this frame.
        Err(_) => Vec::new(),
    }
}

/// What the camera's clock shows at the rig's start, in nanoseconds: up to 1000 s.
pub fn device_zero_ns(seed: u64) -> u64 {
    Stream::new(seed, Purpose::Clock, 0).bits(0) % 1_000_000_000_000
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::chamber::WorldParts;
    use crate::rig::config::{DetectorConfig, ResidualConfig, WarmUpConfig};
    use crate::rig::sample;

    const SECOND: Duration = Duration::from_secs(1);

    struct Bench {
        camera: SimCamera,
        pulses: mpsc::Sender<Pulse>,
        next: u64,
    }

    impl Bench {
        async fn with(world: World, faults: Vec<Fault>) -> Self {
            let (pulses, receiver) = mpsc::channel(64);
            let plate = Box::new(|_now_s: f64| 449.0);
            let world = Arc::new(world);
            let (rows, columns) = (world.sights().rows(), world.sights().columns());
            let mut camera = SimCamera::switch_on(world, plate, faults, WorldState::default(), receiver);
            let settings = CameraSettings { rows, columns, integration_s: 25e-6, bits: 14 };
            let taken = camera.prepare(&settings).await.unwrap();
            assert!((taken.integration_s - 25e-6).abs() < 1e-12);
            camera.start().await.unwrap();
            Self { camera, pulses, next: 0 }
        }

        async fn pulse(&mut self, camera: bool, injector: bool) {
            let pulse = Pulse {
                t0_index: self.next,
                at_ns: self.next * 20_000_000,
                camera: camera.then_some((5_000, 25_000)),
                injector: injector.then_some((0, 1_000_000)),
            };
            self.next += 1;
            self.pulses.send(pulse).await.unwrap();
        }

        async fn shot(&mut self, injector: bool) -> Result<Frame, DriverError> {
            self.pulse(true, injector).await;
            self.camera.frame(SECOND).await
        }
    }

    fn mean(frame: &Frame) -> f64 {
        frame.counts.iter().map(|&c| f64::from(c)).sum::<f64>() / frame.counts.len() as f64
    }

    #[tokio::test(start_paused = true)]
    async fn frames_are_numbered_and_stamped_by_the_cameras_own_clock() {
        let mut bench = Bench::with(sample::world(&sample::Choices::usual()), Vec::new()).await;
        let first = bench.shot(false).await.unwrap();
        bench.pulse(false, false).await;
        let second = bench.shot(false).await.unwrap();
        assert_eq!((first.id, second.id), (0, 1));
        assert_eq!(second.device_ns - first.device_ns, 40_000_000);
        assert_ne!(first.device_ns, 5_000);
        assert_eq!((first.rows, first.columns, first.counts.len()), (12, 16, 192));
        assert!(first.complete);
    }

    #[tokio::test(start_paused = true)]
    async fn spray_is_seen_when_the_injector_fires_in_the_same_pulse() {
        let cold = sample::Choices { medium_k: 350.0, albedo: 0.0, ..sample::Choices::usual() };
        let mut bench = Bench::with(sample::world(&cold), Vec::new()).await;
        let blank = bench.shot(false).await.unwrap();
        let spray = bench.shot(true).await.unwrap();
        let after = bench.shot(false).await.unwrap();
        // 350 K fuel hides most of a plate at 449 K (57 counts); noise of a mean over 192 pixels: 0.1 counts.
        assert!(mean(&spray) < mean(&blank) - 10.0, "{} {}", mean(&spray), mean(&blank));
        assert!((mean(&after) - mean(&blank)).abs() < 0.6);
        assert_eq!(bench.camera.state().injections, 1);
    }

    #[tokio::test(start_paused = true)]
    async fn lost_frame_leaves_a_gap_and_incomplete_frame_says_so() {
        let faults = vec![Fault::LoseFrame { frame: 1 }, Fault::IncompleteFrame { frame: 2 }];
        let mut bench = Bench::with(sample::world(&sample::Choices::usual()), faults).await;
        assert_eq!(bench.shot(false).await.unwrap().id, 0);
        assert!(matches!(bench.shot(false).await, Err(DriverError::Silent { .. })));
        let third = bench.shot(false).await.unwrap();
        assert_eq!((third.id, third.complete), (2, false));
        assert_eq!(third.counts[191], 0);
        assert_eq!(bench.shot(false).await.unwrap().id, 3);
    }

    #[tokio::test(start_paused = true)]
    async fn stuck_camera_comes_back_after_a_restart() {
        let mut bench = Bench::with(sample::bench(2, 2), vec![Fault::Stuck { frame: 1 }]).await;
        bench.shot(false).await.unwrap();
        for _ in 0..3 {
            assert!(bench.shot(false).await.is_err());
        }
        bench.camera.stop().await.unwrap();
        bench.camera.start().await.unwrap();
        assert_eq!(bench.shot(false).await.unwrap().id, 1);
    }

    #[tokio::test(start_paused = true)]
    async fn misfire_shows_no_spray() {
        let world = || sample::world(&sample::Choices::usual());
        let mut good = Bench::with(world(), Vec::new()).await;
        let mut bad = Bench::with(world(), vec![Fault::Misfire { injection: 0 }]).await;
        let (blank, misfired) = (good.shot(false).await.unwrap(), bad.shot(true).await.unwrap());
        assert_eq!(blank.counts, misfired.counts);
        assert_eq!(bad.camera.state().injections, 1);
    }

    #[tokio::test(start_paused = true)]
    async fn closed_shutter_shows_its_own_temperature() {
        let mut bench = Bench::with(sample::bench(60, 80), Vec::new()).await;
        assert_eq!(bench.camera.shutter(true).await.unwrap(), Some(Kelvin(300.0)));
        let closed = bench.shot(false).await.unwrap();
        assert_eq!(bench.camera.shutter(false).await.unwrap(), None);
        let open = bench.shot(false).await.unwrap();
        let expected = sample::bench(1, 1).optics().black_body_electrons_per_s(300.0) * 25e-6 / 427.0 + 500.0;
        // Noise of a mean over 4800 pixels: 1.5 / 69 = 0.02.
        assert!((mean(&closed) - expected).abs() < 0.11, "{} {expected}", mean(&closed));
        assert!(mean(&open) > mean(&closed) + 20.0);
        let mut without = Bench::with(sample::world(&sample::Choices::usual()), Vec::new()).await;
        assert!(matches!(without.camera.shutter(true).await, Err(DriverError::Refused { .. })));
    }

    #[tokio::test(start_paused = true)]
    async fn stopped_camera_ignores_triggers_and_drops_old_frames() {
        let mut bench = Bench::with(sample::bench(1, 1), Vec::new()).await;
        for _ in 0..FRAMES_QUEUED_MAX + 4 {
            bench.pulse(true, false).await;
        }
        tokio::time::sleep(SECOND).await;
        bench.camera.stop().await.unwrap();
        bench.pulse(true, true).await;
        tokio::time::sleep(SECOND).await;
        bench.camera.start().await.unwrap();
        assert!(matches!(bench.camera.frame(SECOND).await, Err(DriverError::Silent { .. })));
        let state = bench.camera.state();
        assert_eq!(state.injections, 1);
        let frame = bench.shot(false).await.unwrap();
        assert_eq!(frame.id, state.exposures);
    }

    #[tokio::test(start_paused = true)]
    async fn wrong_sizes_are_refused_with_what_it_has() {
        let mut bench = Bench::with(sample::bench(1, 1), Vec::new()).await;
        bench.camera.stop().await.unwrap();
        let good = CameraSettings { rows: 1, columns: 1, integration_s: 25e-6, bits: 14 };
        for wrong in [
            CameraSettings { rows: 2, ..good.clone() },
            CameraSettings { bits: 12, ..good.clone() },
            CameraSettings { integration_s: 1.0, ..good.clone() },
        ] {
            assert!(matches!(bench.camera.prepare(&wrong).await, Err(DriverError::Refused { .. })));
        }
        bench.camera.prepare(&good).await.unwrap();
    }

    /// Same seed and pulses, same bits; going on from a saved state gives the bits of the uninterrupted run.
    #[tokio::test(start_paused = true)]
    async fn restored_state_goes_on_with_the_same_bits() {
        let world = || {
            let mut parts: WorldParts = sample::parts(&sample::Choices::usual());
            parts.residual = Some(ResidualConfig { optical_depth: 0.4, decay_s: 4.0 });
            parts.detector = DetectorConfig {
                warm_up: Some(WarmUpConfig { counts: 30.0, frames: 1.0, idle_s: 0.5 }),
                ..parts.detector
            };
            World::new(parts).unwrap()
        };
        let mut whole = Bench::with(world(), Vec::new()).await;
        whole.shot(true).await.unwrap();
        let state = whole.camera.state();
        let mut rest = Bench::with(world(), Vec::new()).await;
        rest.camera.restore(state);
        rest.next = whole.next;
        for injector in [false, true, false] {
            assert_eq!(whole.shot(injector).await.unwrap(), rest.shot(injector).await.unwrap());
        }
    }

    /// A long pause flushes the vapour: the blank of the next cycle is as bright as the first one's.
    #[tokio::test(start_paused = true)]
    async fn pause_flushes_the_vapour() {
        let mut parts = sample::parts(&sample::Choices { columns: 80, rows: 60, ..sample::Choices::usual() });
        parts.residual = Some(ResidualConfig { optical_depth: 1.0, decay_s: 4.0 });
        let mut bench = Bench::with(World::new(parts).unwrap(), Vec::new()).await;
        let before = bench.shot(false).await.unwrap();
        bench.shot(true).await.unwrap();
        let soon = bench.shot(false).await.unwrap();
        bench.next += 50 * 40;
        let later = bench.shot(false).await.unwrap();
        // Gas at 480 K behind the spray is brighter than the plate at 449 K.
        assert!(mean(&soon) > mean(&before) + 1.0, "{} {}", mean(&soon), mean(&before));
        assert!((mean(&later) - mean(&before)).abs() < 0.15);
    }
}
