//! What the control channel says.

use super::*;
use crate::rig::RigError;

const NOT_IMPLEMENTED: u16 = 0x8001;
const INVALID_PARAMETER: u16 = 0x8002;
const INVALID_ADDRESS: u16 = 0x8003;
const WRITE_PROTECT: u16 = 0x8004;
const BAD_ALIGNMENT: u16 = 0x8005;
const ACCESS_DENIED: u16 = 0x8006;
const BUSY: u16 = 0x8007;

#[tokio::test]
async fn discovery_tells_names_and_address() {
    let server = camera(|camera| camera).await;
    let mut client = Client::of(&server).await;
    let (status, bytes) = client.ask(&Command::Discovery).await;
    assert_eq!((status, bytes.len()), (SUCCESS, 0xF8));
    assert_eq!(bytes[0x24..0x28], [127, 0, 0, 1]);
    assert!(bytes[0x48..].starts_with(b"ditd\0"));
    assert!(bytes[0x68..].starts_with(b"pattern camera\0"));
    assert!(bytes[0xD8..].starts_with(b"PATTERN-0001"));
    client.read_description().await;
    assert!(client.description.starts_with("<?xml") && client.description.contains("ExposureTime"));
}

#[tokio::test]
async fn every_status_has_its_cause() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    let width = client.address("Width");
    let payload = client.address("PayloadSize");
    assert_eq!(client.ask(&Command::ForceIp).await.0, NOT_IMPLEMENTED);
    assert_eq!(client.ask(&Command::Unknown).await.0, NOT_IMPLEMENTED);
    assert_eq!(client.write(width, 66).await, INVALID_PARAMETER);
    assert_eq!(client.write(width, 68).await, INVALID_PARAMETER);
    assert_eq!(client.write(0x0F00_0000, 1).await, INVALID_ADDRESS);
    assert_eq!(client.read(0x0F00_0000, 4).await, Err(INVALID_ADDRESS));
    assert_eq!(client.read(0xFFFF_FFFC, 512).await, Err(INVALID_ADDRESS));
    assert_eq!(client.write(payload, 1).await, WRITE_PROTECT);
    assert_eq!(client.write(0x0000, 1).await, WRITE_PROTECT);
    assert_eq!(client.write(width + 2, 64).await, BAD_ALIGNMENT);
    assert_eq!(client.read(width, 6).await, Err(BAD_ALIGNMENT));
    assert_eq!(client.get("Width").await, 64);
    // Nothing is pending or streaming so far; with a stream the region is locked.
    client.start_software().await;
    assert_eq!(client.write(width, 32).await, BUSY);
    assert_eq!(client.set("AcquisitionStop", 1).await, SUCCESS);
    assert_eq!(client.write(width, 32).await, SUCCESS);
    assert_eq!(client.get("PayloadSize").await, 32 * 8 * 2);
    assert_eq!(server.stats().refused, 12);
}

#[tokio::test]
async fn several_registers_in_one_command_up_to_the_first_refusal() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    let (width, height) = (client.address("Width"), client.address("Height"));
    let writes = vec![(width, 32), (height, 9), (width, 16)];
    let (status, payload) = client.ask(&Command::WriteRegister(writes)).await;
    assert_eq!((status, payload), (INVALID_PARAMETER, vec![0, 0, 0, 1]));
    let (status, payload) = client.ask(&Command::ReadRegister(vec![width, height])).await;
    assert_eq!((status, payload), (SUCCESS, [32_u32.to_be_bytes(), 8_u32.to_be_bytes()].concat()));
    let (status, payload) = client.ask(&Command::ReadRegister(vec![width, 1 << 30, height])).await;
    assert_eq!((status, payload), (INVALID_ADDRESS, 32_u32.to_be_bytes().to_vec()));
}

#[tokio::test]
async fn second_client_reads_but_does_not_write() {
    let server = camera(|camera| camera).await;
    let mut first = Client::of(&server).await;
    let mut second = Client::of(&server).await;
    // Nobody has control yet: not even an only client may write.
    assert_eq!(first.write(HEARTBEAT, 1000).await, ACCESS_DENIED);
    assert_eq!(first.write(CCP, 2).await, SUCCESS);
    assert_eq!(second.write(CCP, 2).await, ACCESS_DENIED);
    assert_eq!(second.write(HEARTBEAT, 1000).await, ACCESS_DENIED);
    assert_eq!(second.word(CCP).await, 2);
    // Exclusive control hides everything but discovery.
    assert_eq!(first.write(CCP, 1).await, SUCCESS);
    assert_eq!(second.read(CCP, 4).await, Err(ACCESS_DENIED));
    assert_eq!(second.ask(&Command::Discovery).await.0, SUCCESS);
    assert_eq!(first.word(CCP).await, 1);
    assert_eq!(second.write(CCP, 0).await, ACCESS_DENIED);
    assert_eq!(first.write(CCP, 0).await, SUCCESS);
    assert_eq!(second.write(CCP, 2).await, SUCCESS);
}

#[tokio::test]
async fn silence_costs_control_and_stops_the_stream() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    client.start_software().await;
    client.shot().await;
    assert_eq!(client.write(HEARTBEAT, 1).await, SUCCESS);
    // The standard's least is half a second.
    until("loss of control", || server.stats().control_lost == 1).await;
    assert_eq!(client.word(CCP).await, 0);
    assert_eq!(client.set("TriggerSoftware", 1).await, ACCESS_DENIED);
    let camera = server.stop().await;
    assert!(camera.is_some());
}

/// Any command of the owner is a heartbeat: a client that polls keeps control over many timeouts.
#[tokio::test]
async fn ignored_heartbeats_cost_control_although_the_client_lives() {
    let server = faulty(GigeFault::HeartbeatIgnored { after_s: 0.0 }).await;
    let mut client = Client::of(&server).await;
    assert_eq!(client.write(CCP, 2).await, SUCCESS);
    // The timeout that began with control is the delivered one; polling does not put it off.
    let polling = async {
        while client.word(CCP).await != 0 {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    timeout(LONG, polling).await.expect("loss of control");
    assert_eq!(server.stats().control_lost, 1);
}

#[tokio::test]
async fn repeated_command_is_answered_again_and_not_done_again() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    client.start_software().await;
    let trigger = client.address("TriggerSoftware");
    client.id += 1;
    let bytes = command(&Command::WriteRegister(vec![(trigger, 1)]), client.id);
    let id = client.id;
    for _ in 0..3 {
        assert_eq!(client.exchange(&bytes, id).await, (SUCCESS, vec![0, 0, 0, 1]));
    }
    client.block().await;
    let stats = server.stats();
    assert_eq!((stats.triggers, stats.repeated, stats.frames), (1, 2, 1));
    // The same command with the next id is a new one.
    client.shot().await;
    assert_eq!(server.stats().triggers, 2);
}

#[tokio::test]
async fn lost_answers_are_had_by_asking_again() {
    let server = faulty(GigeFault::AnswerLost { every: 2 }).await;
    let mut client = Client::of(&server).await;
    assert_eq!(client.write(CCP, 2).await, SUCCESS);
    client.id += 1;
    let (id, bytes) = (client.id, command(&Command::WriteRegister(vec![(HEARTBEAT, 4000)]), client.id));
    client.socket.send(&bytes).await.unwrap();
    until("the loss of an answer", || server.stats().answers_lost == 1).await;
    assert_eq!(client.exchange(&bytes, id).await.0, SUCCESS);
    assert_eq!(server.stats().repeated, 1);
}

#[tokio::test]
async fn late_answers_come_after_younger_ones() {
    let server = faulty(GigeFault::AnswerLate { every: 2, delay_s: 0.2 }).await;
    let client = Client::of(&server).await;
    for id in 1..=3 {
        let asked = command(&Command::ReadRegister(vec![CCP]), id);
        client.socket.send(&asked).await.unwrap();
    }
    let mut order = Vec::new();
    let mut buffer = [0; 64];
    while order.len() < 3 {
        let count = timeout(LONG, client.socket.recv(&mut buffer)).await.unwrap().unwrap();
        order.push(answer(&buffer[..count]).unwrap().2);
    }
    assert_eq!(order, [1, 3, 2]);
    assert_eq!(server.stats().answers_late, 1);
}

#[tokio::test]
async fn what_takes_long_is_announced() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    assert_eq!(client.set("NUCExecute", 1).await, SUCCESS);
    assert!(client.pending >= 1);
    let stats = server.stats();
    assert_eq!((stats.corrections, stats.pending), (1, u64::from(client.pending)));
}

/// While an act is under way its repetition is told to wait, reads are answered, writes are busy.
#[tokio::test]
async fn during_a_long_act_reads_are_answered_and_writes_are_busy() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    client.id += 1;
    let correct = client.address("NUCExecute");
    let (id, bytes) = (client.id, command(&Command::WriteRegister(vec![(correct, 1)]), client.id));
    client.socket.send(&bytes).await.unwrap();
    assert_eq!(client.write(HEARTBEAT, 500_000).await, BUSY);
    assert_eq!(client.word(HEARTBEAT).await, 600_000);
    assert_eq!(client.exchange(&bytes, id).await.0, SUCCESS);
    assert!(client.pending >= 1);
    assert_eq!(server.stats().corrections, 1);
}

#[tokio::test]
async fn test_packets_have_the_size_that_was_asked() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    for (asked, taken) in [(1500, 1500), (9000, 9000), (1003, 1000), (60, 576), (20_000, 9000)] {
        assert_eq!(client.write(0x0D04, 1 << 31 | asked).await, SUCCESS);
        let mut buffer = vec![0; 16_384];
        let count = timeout(LONG, client.stream.recv(&mut buffer)).await.unwrap().unwrap();
        assert_eq!(count + 28, taken as usize);
        assert_eq!(client.word(0x0D04).await, taken);
    }
    assert_eq!(server.stats().test_packets, 5);
}

#[tokio::test]
async fn user_name_outlives_a_restart_and_other_registers_do_not() {
    let server = faulty(GigeFault::Restart { frame: 1, silent_s: 0.0 }).await;
    let mut client = Client::in_control(&server).await;
    let name = Command::WriteMemory { address: 0xE8, bytes: b"rig camera\0\0\0\0\0\0".to_vec() };
    assert_eq!(client.ask(&name).await, (SUCCESS, vec![0, 0, 0, 16]));
    assert_eq!(client.set("Width", 32).await, SUCCESS);
    client.start_software().await;
    client.shot().await;
    client.trigger().await;
    until("the restart", || server.stats().restarts == 1).await;
    assert_eq!(client.word(CCP).await, 0);
    assert_eq!(client.get("Width").await, 64);
    assert_eq!(client.word(0x0D00).await, 0);
    assert!(client.read(0xE8, 16).await.unwrap().starts_with(b"rig camera\0"));
    // Set up again, it goes on.
    let mut client = Client::in_control(&server).await;
    client.start_software().await;
    assert_eq!(client.shot().await.id, 1);
}

#[tokio::test]
async fn reset_is_acknowledged_and_then_nothing_is_heard_for_a_while() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    assert_eq!(client.set("Width", 32).await, SUCCESS);
    client.start_software().await;
    assert_eq!(client.set("DeviceReset", 1).await, SUCCESS);
    assert_eq!(server.stats().restarts, 1);
    let width = client.address("Width");
    let asked = command(&Command::ReadMemory { address: width, count: 4 }, 60_000);
    let mut every = interval(Duration::from_millis(100));
    let mut tries = 0;
    let heard = async {
        let mut buffer = [0; 64];
        loop {
            every.tick().await;
            tries += 1;
            client.socket.send(&asked).await.expect("loopback takes it");
            if let Ok(count) = client.socket.try_recv(&mut buffer) {
                return answer(&buffer[..count]).expect("an acknowledge").3;
            }
        }
    };
    let payload = timeout(LONG, heard).await.expect("it comes back");
    assert_eq!(payload[4..], 64_u32.to_be_bytes());
    // Two seconds of silence are twenty tries.
    assert!(tries > 5, "{tries}");
}

#[tokio::test]
async fn denied_control_is_denied_to_everybody() {
    let server = faulty(GigeFault::AccessDenied).await;
    let mut client = Client::of(&server).await;
    assert_eq!(client.write(CCP, 2).await, ACCESS_DENIED);
    assert_eq!(client.word(CCP).await, 0);
}

#[tokio::test]
async fn clock_is_latched_and_reset() {
    let start = tokio::time::Instant::now();
    let server = camera(|camera| camera.clock(start, 5_000_000_000_000)).await;
    let mut client = Client::in_control(&server).await;
    let latched = async |client: &mut Client| {
        assert_eq!(client.write(0x0944, 2).await, SUCCESS);
        let bytes = client.read(0x0948, 8).await.unwrap();
        u64::from_be_bytes(*bytes.first_chunk().unwrap())
    };
    let first = latched(&mut client).await;
    let second = latched(&mut client).await;
    assert!(5_000_000_000_000 <= first && first < second);
    assert_eq!(client.write(0x0944, 1).await, SUCCESS);
    let third = latched(&mut client).await;
    assert!(third < u64::try_from(LONG.as_nanos()).unwrap(), "{third}");
    assert_eq!(client.word(0x0940).await, 1_000_000_000);
}

#[tokio::test]
async fn impossible_cameras_are_refused() {
    let (_pulses, taken) = mpsc::channel(1);
    let pattern = || Box::new(PatternCamera::new(8, 64, 14, mpsc::channel(1).1));
    let make = || GigeCamera::new(pattern(), SENSOR);
    let refused = async |camera: GigeCamera, at: &str| camera.serve_at(at.parse().unwrap()).await.err();
    let key = |error: Option<RigError>| match error {
        Some(RigError::Config { key, .. }) => key,
        other => panic!("{other:?}"),
    };
    assert_eq!(key(refused(make(), "0.0.0.0:0").await), "camera.address");
    assert_eq!(key(refused(make(), "224.0.0.1:0").await), "camera.address");
    let fault = GigeFault::PacketLoss { probability: 2.0 };
    assert_eq!(key(refused(make().faults(vec![fault], 1), "127.0.0.1:0").await), "camera.fault");
    assert_eq!(key(refused(make().initial("Nonsense", 1.0), "127.0.0.1:0").await), "camera");
    assert_eq!(key(refused(make().initial("PixelFormat", 1.0), "127.0.0.1:0").await), "camera");
    let narrow = Sensor { columns: 32, ..SENSOR };
    let narrow = GigeCamera::new(pattern(), narrow).preset(Preset::Telops);
    assert_eq!(key(refused(narrow, "127.0.0.1:0").await), "camera");
    let server = camera(|camera| camera).await;
    let taken_port = GigeCamera::new(Box::new(PatternCamera::new(8, 64, 14, taken)), SENSOR);
    let error = taken_port.serve_at(server.address()).await.err();
    assert!(matches!(error, Some(RigError::Network { .. })), "{error:?}");
}

/// Three datagrams that are no commands, and a good one after them.
#[tokio::test]
async fn noise_on_the_port_is_ignored() {
    let server = camera(|camera| camera).await;
    let mut client = Client::of(&server).await;
    for noise in [vec![], vec![0x42], vec![0xFF; 600]] {
        client.socket.send(&noise).await.unwrap();
    }
    assert_eq!(client.word(0x0000).await, 0x0002_0000);
    assert_eq!(server.stats().commands, 1);
}
