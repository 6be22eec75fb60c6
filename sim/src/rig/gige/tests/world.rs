//! The simulated camera behind the network: the same counts as in process, its losses as gaps of ids.

use super::*;
use crate::rig::camera::{SimCamera, WorldState};
use crate::rig::config::Fault;
use crate::rig::pulse::Pulse;
use crate::rig::sample;
use ditd_drivers::instrument::{Camera, CameraSettings, Frame};
use std::sync::Arc;
use tokio::time::Instant;

const ROWS: usize = 12;
const COLUMNS: usize = 16;

fn sim_camera(faults: Vec<Fault>) -> (SimCamera, mpsc::Sender<Pulse>) {
    let (pulses, taken) = mpsc::channel(16);
    let world = Arc::new(sample::bench(ROWS, COLUMNS));
    let plate = Box::new(|_now_s: f64| 449.0);
    (SimCamera::switch_on(world, plate, faults, WorldState::default(), taken), pulses)
}

/// What the camera gives in process; the bench has neither drift nor vapour: its counts do not depend on the time.
async fn in_process(count: u64) -> Vec<Frame> {
    let (mut camera, pulses) = sim_camera(Vec::new());
    let settings = CameraSettings { rows: ROWS, columns: COLUMNS, integration_s: 25e-6, bits: 14 };
    camera.prepare(&settings).await.expect("its own settings");
    camera.start().await.expect("prepared");
    let mut frames = Vec::new();
    for t0_index in 0..count {
        let pulse = Pulse { t0_index, at_ns: 1000 * t0_index, camera: Some((0, 10)), injector: None };
        pulses.send(pulse).await.expect("it lives");
        frames.push(camera.frame(LONG).await.expect("a frame"));
    }
    frames
}

#[tokio::test]
async fn counts_are_those_of_the_camera_in_process() {
    let expected = in_process(3).await;
    let (camera, pulses) = sim_camera(vec![Fault::LoseFrame { frame: 1 }]);
    let zero_ns = camera.clock_zero_ns();
    let sensor = Sensor { rows: 12, columns: 16, bits: 14, shutter: true };
    let server = GigeCamera::new(Box::new(camera), sensor)
        .pulses(pulses)
        .clock(Instant::now(), zero_ns)
        .serve_at(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0))
        .await
        .unwrap();
    let mut client = Client::in_control(&server).await;
    assert_eq!(client.set_double("ExposureTime", 25.0).await, SUCCESS);
    client.start_software().await;
    let first = client.shot().await;
    assert_eq!((first.id, &first.samples()[..]), (1, &expected[0].counts[..]));
    assert!(first.timestamp() > zero_ns);
    client.trigger().await;
    let third = client.shot().await;
    assert_eq!((third.id, &third.samples()[..]), (3, &expected[2].counts[..]));
    assert_eq!(server.stats().frames_missing, 1);
    assert!(server.stop().await.is_some());
}
