//! The thread of a GigE camera: orders in, answers and frames out.

use super::GigeSettings;
use super::device::Device;
use super::sequence::Numbers;
use super::stream::Got;
use crate::error::DriverError;
use crate::instrument::{CameraClock, CameraSettings, Frame, Identity};
use crate::quantity::Kelvin;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};

/// Frames that wait to be fetched: 10.5 MB at 640 × 512 pixels of two bytes. When full, a new frame is dropped and counted.
pub(super) const FRAMES_QUEUED_MAX: usize = 16;

/// How long the library is waited for before orders are looked at again.
const SLICE: Duration = Duration::from_millis(5);

type Answer<T> = oneshot::Sender<Result<T, DriverError>>;

/// What the thread can be told.
pub(super) enum Order {
    Open(Answer<()>),
    Identify(Answer<Identity>),
    Check(Answer<()>),
    Prepare(CameraSettings, Answer<CameraSettings>),
    Shutter(bool, Answer<Option<Kelvin>>),
    CorrectOffset(Answer<()>),
    Clock(Answer<Option<CameraClock>>),
    Start(Answer<mpsc::Receiver<Result<Frame, DriverError>>>),
    Stop(Answer<Vec<(&'static str, u64)>>),
}

/// The thread and the way to it; it ends when this is dropped.
pub(super) struct Worker {
    orders: Option<Sender<Order>>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// Starts the thread; the camera is opened by an order.
    pub(super) fn start(who: String, address: String, settings: GigeSettings) -> std::io::Result<Self> {
        let (orders, received) = channel();
        let thread = std::thread::Builder::new().name("gige camera".to_owned()).spawn(move || {
            Thread { who, address, settings, device: None, numbers: Numbers::default(), frames: None }
                .live(&received);
        })?;
        Ok(Self { orders: Some(orders), thread: Some(thread) })
    }

    /// Hands an order over; false when the thread has ended.
    pub(super) fn order(&self, order: Order) -> bool {
        self.orders.as_ref().is_some_and(|orders| orders.send(order).is_ok())
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.orders = None;
        if let Some(thread) = self.thread.take() {
            // The stream must have ended before the process does, or the library's threads outlive it.
            let _ = thread.join();
        }
    }
}

struct Thread {
    who: String,
    address: String,
    settings: GigeSettings,
    device: Option<Device>,
    numbers: Numbers,
    frames: Option<mpsc::Sender<Result<Frame, DriverError>>>,
}

impl Thread {
    fn live(mut self, orders: &Receiver<Order>) {
        loop {
            let order = if self.frames.is_some() {
                match orders.try_recv() {
                    Ok(order) => Some(order),
                    Err(TryRecvError::Empty) => None,
                    Err(TryRecvError::Disconnected) => return,
                }
            } else {
                match orders.recv() {
                    Ok(order) => Some(order),
                    Err(_) => return,
                }
            };
            match order {
                Some(order) => self.obey(order),
                None => self.forward(),
            }
        }
    }

    fn forward(&mut self) {
        let (Some(device), Some(frames)) = (&mut self.device, &self.frames) else { return };
        let (message, over) = match device.next(SLICE) {
            Got::Nothing => return,
            Got::Frame(frame) => (Ok(frame), false),
            Got::Lost(error) | Got::Wrong(error) => (Err(error), true),
        };
        match frames.try_send(message) {
            Err(mpsc::error::TrySendError::Full(_)) => device.note_dropped(),
            Err(mpsc::error::TrySendError::Closed(_)) => self.frames = None,
            Ok(()) => {}
        }
        if over {
            self.frames = None;
        }
    }

    // An answer that nobody waits for any more is dropped.
    fn obey(&mut self, order: Order) {
        match order {
            Order::Open(answer) => drop(answer.send(self.open())),
            Order::Identify(answer) => drop(answer.send(self.with(|device| device.identify()))),
            Order::Check(answer) => drop(answer.send(self.with(|device| device.check()))),
            Order::Prepare(settings, answer) => {
                self.frames = None;
                drop(answer.send(self.with(|device| device.prepare(&settings))));
            }
            Order::Shutter(closed, answer) => {
                drop(answer.send(self.with(|device| device.shutter(closed))));
            }
            Order::CorrectOffset(answer) => {
                drop(answer.send(self.with(|device| device.correct_offset())));
            }
            Order::Clock(answer) => drop(answer.send(self.with(|device| device.clock()))),
            Order::Start(answer) => {
                self.frames = None;
                let (sender, receiver) = mpsc::channel(FRAMES_QUEUED_MAX);
                let started = self.with(|device| device.start()).map(|()| receiver);
                if started.is_ok() {
                    self.frames = Some(sender);
                }
                drop(answer.send(started));
            }
            Order::Stop(answer) => {
                self.frames = None;
                if let Some(device) = &mut self.device {
                    device.stop();
                }
                let counters = self.device.as_ref().map(Device::counters).unwrap_or_default();
                drop(answer.send(Ok(counters)));
            }
        }
    }

    fn open(&mut self) -> Result<(), DriverError> {
        self.frames = None;
        if let Some(device) = self.device.take() {
            self.numbers = device.numbers();
        }
        let mut device = Device::open(&self.who, &self.address, &self.settings)?;
        device.go_on_from(self.numbers.clone());
        self.device = Some(device);
        Ok(())
    }

    fn with<T>(&mut self, act: impl FnOnce(&mut Device) -> Result<T, DriverError>) -> Result<T, DriverError> {
        match &mut self.device {
            Some(device) => act(device),
            None => Err(DriverError::lost(
                &self.who,
                "talking to it",
                "it is not open",
                "Check the camera's power and network cable.",
            )),
        }
    }
}
