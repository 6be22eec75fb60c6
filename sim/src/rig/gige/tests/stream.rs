//! What the stream brings.

use super::*;
use crate::rig::gige::pattern::pattern_count;
use async_trait::async_trait;
use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{Camera, CameraSettings, Frame, Identity};
use ditd_drivers::quantity::Kelvin;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

const UNAVAILABLE: u16 = 0x800C;

fn expected(id: u64) -> Vec<u16> {
    let places = (0..8).flat_map(|row| (0..64).map(move |column| (row, column)));
    places.map(|(row, column)| pattern_count(id, row, column)).collect()
}

#[tokio::test]
async fn triggered_frames_come_whole_and_in_order() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    client.start_software().await;
    let mut before = 0;
    for id in 0..3 {
        let block = client.shot().await;
        assert_eq!((block.id, block.trailer), (id + 1, Some(3)));
        assert!(block.is_whole());
        assert_eq!(block.samples(), expected(id));
        assert!(block.timestamp() > before);
        before = block.timestamp();
    }
    assert_eq!(client.set("AcquisitionStop", 1).await, SUCCESS);
    // A trigger after the stop makes nothing; a new start begins with 1.
    client.trigger().await;
    client.start_software().await;
    assert_eq!(client.shot().await.id, 1);
    let stats = server.stats();
    assert_eq!((stats.streams, stats.frames_sent, stats.triggers, stats.triggers_missed), (2, 4, 4, 1));
    assert_eq!((stats.packets_sent, stats.packets_failed), (16, 0));
}

#[tokio::test]
async fn window_and_leader_follow_the_registers() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    for (feature, value) in
        [("Width", 16), ("Height", 3), ("OffsetX", 48), ("OffsetY", 5), ("PixelFormat", 0x0110_0025)]
    {
        assert_eq!(client.set(feature, value).await, SUCCESS, "{feature}");
    }
    client.start_software().await;
    let block = client.shot().await;
    let whole = expected(0);
    let cut: Vec<u16> = (5..8).flat_map(|row| whole[64 * row + 48..64 * (row + 1)].to_vec()).collect();
    assert_eq!(block.samples(), cut);
    let leader = block.leader.unwrap();
    let fields: Vec<u32> =
        leader[12..].as_chunks::<4>().0.iter().map(|&field| u32::from_be_bytes(field)).collect();
    assert_eq!(fields, [0x0110_0025, 16, 3, 48, 5, 0]);
}

#[tokio::test]
async fn free_run_keeps_its_rate_in_the_timestamps() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    assert_eq!(client.set_double("AcquisitionFrameRate", 500.0).await, SUCCESS);
    assert_eq!(client.set("AcquisitionMode", 2).await, SUCCESS);
    assert_eq!(client.set("AcquisitionFrameCount", 5).await, SUCCESS);
    assert_eq!(client.set("AcquisitionStart", 1).await, SUCCESS);
    let mut times = Vec::new();
    for _ in 0..5 {
        times.push(client.block().await.timestamp());
    }
    for pair in times.windows(2) {
        // 2 ms apart, or more when a trigger was missed; rounding of each time to a nanosecond.
        let steps = (pair[1] - pair[0] + 1_000_000) / 2_000_000;
        assert!(steps >= 1 && (pair[1] - pair[0]).abs_diff(2_000_000 * steps) <= 2, "{times:?}");
    }
    // Five were ordered: the stream has ended by itself, and the registers are free again.
    until("the end of the stream", || server.stats().frames == 5).await;
    let width = client.address("Width");
    let polling = async { while client.write(width, 32).await != SUCCESS {} };
    timeout(LONG, polling).await.expect("the registers are unlocked");
}

#[tokio::test]
async fn lost_packets_are_had_again_until_the_frame_is_whole() {
    let server = faulty(GigeFault::PacketLoss { probability: 0.3 }).await;
    let mut client = Client::in_control(&server).await;
    client.start_software().await;
    for id in 1..=6 {
        client.trigger().await;
        until("the frame", || server.stats().frames_sent == id).await;
        let mut block = Collected::default();
        // A packet is lost ten times in a row once in 170000.
        for _ in 0..10 {
            let sent = server.stats().packets_sent;
            let mut buffer = [0; 2048];
            while let Ok(count) = client.stream.try_recv(&mut buffer) {
                let packet = parse(&buffer[..count]).unwrap();
                assert_eq!((packet.status, packet.block), (0, id));
                match packet.format {
                    LEADER => block.leader = Some(packet.content),
                    TRAILER => block.trailer = Some(packet.packet),
                    _ => drop(block.payload.insert(packet.packet, packet.content)),
                }
            }
            if block.is_whole() {
                break;
            }
            let before = server.stats().packets_resent;
            client.resend(ResendRange { block: id, first: 0, last: 3 }).await;
            until("resending", || server.stats().packets_resent == before + 4).await;
            assert!(server.stats().packets_sent >= sent);
        }
        assert!(block.is_whole(), "{id}");
        assert_eq!(block.samples(), expected(id - 1));
    }
    assert!(server.stats().packets_dropped > 0);
}

#[tokio::test]
async fn frames_out_of_memory_and_refused_resends_are_answered_so() {
    for (fault, block) in [(None, 77), (Some(GigeFault::ResendRefused), 1)] {
        let server = camera(|camera| camera.faults(fault.into_iter().collect(), 1)).await;
        let mut client = Client::in_control(&server).await;
        client.start_software().await;
        client.shot().await;
        client.resend(ResendRange { block, first: 1, last: 2 }).await;
        for number in 1..=2 {
            let packet = client.packet().await;
            assert_eq!((packet.status, packet.block, packet.packet), (UNAVAILABLE, block, number));
        }
        until("the count", || server.stats().packets_refused == 2).await;
    }
}

/// Only the owner's address is served, and no range makes the camera send for ever.
#[tokio::test]
async fn absurd_resend_ranges_are_bounded() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    client.start_software().await;
    client.shot().await;
    client.resend(ResendRange { block: 1, first: 3, last: 1 }).await;
    client.resend(ResendRange { block: 1, first: 2, last: 0x00FF_FFFF }).await;
    // All ones mean: to the end of the block.
    assert_eq!([client.packet().await.packet, client.packet().await.packet], [2, 3]);
    client.resend(ResendRange { block: 1, first: 0x00FF_FFFE, last: 0x00FF_FFFF }).await;
    assert_eq!(client.packet().await.status, UNAVAILABLE);
    until("three requests", || server.stats().resend_requests == 3).await;
}

#[tokio::test]
async fn ids_wrap_without_zero_and_extended_ones_do_not_wrap() {
    for (extended, ids) in [(0, [65_534, 65_535, 1]), (1 << 30, [65_534, 65_535, 65_536])] {
        let server = faulty(GigeFault::IdStart { id: 65_534 }).await;
        let mut client = Client::in_control(&server).await;
        assert_eq!(client.write(0x0960, extended).await, SUCCESS);
        client.start_software().await;
        for (number, id) in (0..).zip(ids) {
            let block = client.shot().await;
            assert_eq!(block.id, id);
            assert_eq!(block.samples(), expected(number));
        }
        client.resend(ResendRange { block: ids[2], first: 0, last: 0 }).await;
        let again = client.packet().await;
        assert_eq!((again.status, again.block, again.format), (0, ids[2], LEADER));
    }
}

#[tokio::test]
async fn lost_frames_leave_gaps_and_jumps_too() {
    let faults = vec![
        GigeFault::LoseFrame { frame: 1 },
        GigeFault::IdJump { frame: 3, by: 10 },
        GigeFault::TimestampStep { frame: 3, step_ns: 1_000_000_000_000_000 },
        GigeFault::WrongPixelFormat { code: 0x0108_0001 },
    ];
    let server = camera(|camera| camera.faults(faults, 1)).await;
    let mut client = Client::in_control(&server).await;
    client.start_software().await;
    assert_eq!(client.shot().await.id, 1);
    client.trigger().await;
    until("the lost frame", || server.stats().frames_lost == 1).await;
    let third = client.shot().await;
    assert_eq!((third.id, third.samples()), (3, expected(2)));
    assert_eq!(third.leader.as_ref().unwrap()[12..16], [1, 8, 0, 1]);
    let fourth = client.shot().await;
    assert_eq!((fourth.id, fourth.samples()), (14, expected(3)));
    assert!(fourth.timestamp() - third.timestamp() > 1_000_000_000_000_000);
}

#[tokio::test]
async fn faults_come_and_go_while_it_runs() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    client.start_software().await;
    assert_eq!(client.shot().await.id, 1);
    assert!(server.play(vec![GigeFault::FrameLoss { probability: -1.0 }]).is_err());
    server.play(vec![GigeFault::FrameLoss { probability: 1.0 }]).unwrap();
    client.trigger().await;
    until("the loss", || server.stats().frames_lost == 1).await;
    server.play(Vec::new()).unwrap();
    assert_eq!(client.shot().await.id, 3);
}

/// Ended by itself and started again at once, many times: the registers never say the contrary of what is.
#[tokio::test]
async fn short_streams_end_and_start_again() {
    let server = camera(|camera| camera).await;
    let mut client = Client::in_control(&server).await;
    assert_eq!(client.set("AcquisitionMode", 1).await, SUCCESS);
    assert_eq!(client.set_double("AcquisitionFrameRate", 1000.0).await, SUCCESS);
    for number in 1..=20 {
        assert_eq!(client.set("AcquisitionStart", 1).await, SUCCESS);
        assert_eq!(client.block().await.id, 1);
        let width = client.address("Width");
        let unlocked = async { while client.write(width, 64).await != SUCCESS {} };
        timeout(LONG, unlocked).await.expect("the registers are unlocked");
        assert_eq!(server.stats().streams, number);
    }
}

#[tokio::test]
async fn packet_faults_do_what_they_say() {
    let kinds = async |fault: GigeFault, count: usize| {
        let server = faulty(fault).await;
        let mut client = Client::in_control(&server).await;
        client.start_software().await;
        client.trigger().await;
        let mut packets = Vec::new();
        while packets.len() < count {
            let packet = client.packet().await;
            packets.push((packet.packet, packet.content.len()));
        }
        packets
    };
    let numbers = |packets: Vec<(u32, usize)>| packets.into_iter().map(|packet| packet.0).collect::<Vec<_>>();
    let doubled = kinds(GigeFault::Duplicated { probability: 1.0 }, 8).await;
    assert_eq!(numbers(doubled), [0, 0, 1, 1, 2, 2, 3, 3]);
    let cut = kinds(GigeFault::Truncated { probability: 1.0 }, 4).await;
    // Half of 8 + 540 and of 8 + 484 bytes, less the header.
    assert_eq!([cut[1].1, cut[2].1], [266, 238]);
    let late = kinds(GigeFault::LatePackets { probability: 1.0, delay_s: 0.01 }, 4).await;
    let mut late = numbers(late);
    late.sort_unstable();
    assert_eq!(late, [0, 1, 2, 3]);
    assert_eq!(numbers(kinds(GigeFault::LoseLeader { frame: 0 }, 3).await), [1, 2, 3]);
    assert_eq!(numbers(kinds(GigeFault::LoseTrailer { frame: 0 }, 3).await), [0, 1, 2]);
    let swapped = kinds(GigeFault::Reordered { probability: 1.0 }, 4).await;
    assert_eq!(numbers(swapped), [1, 0, 3, 2]);
}

#[tokio::test]
async fn stalled_stream_loses_frames_and_goes_on() {
    let server = faulty(GigeFault::Stall { frame: 1, duration_s: 0.1 }).await;
    let mut client = Client::in_control(&server).await;
    client.start_software().await;
    assert_eq!(client.shot().await.id, 1);
    client.trigger().await;
    until("the stall", || server.stats().frames_lost == 1).await;
    let goes_on = async {
        loop {
            let lost = server.stats().frames_lost;
            client.trigger().await;
            until("a frame", || server.stats().frames_lost > lost || server.stats().frames_sent > 1).await;
            if server.stats().frames_sent > 1 {
                return client.block().await;
            }
        }
    };
    let block = timeout(LONG, goes_on).await.expect("it goes on");
    assert_eq!(block.id, server.stats().frames_lost + 2);
}

/// What a camera is made to say, in order.
struct Scripted(VecDeque<Result<Frame, DriverError>>);

#[async_trait]
impl Camera for Scripted {
    async fn identify(&mut self) -> Result<Identity, DriverError> {
        let text = || "scripted".to_owned();
        Ok(Identity { maker: text(), model: text(), serial: text(), firmware: text() })
    }

    async fn prepare(&mut self, settings: &CameraSettings) -> Result<CameraSettings, DriverError> {
        // It takes twice what it is told.
        Ok(CameraSettings { integration_s: 2.0 * settings.integration_s, ..settings.clone() })
    }

    async fn shutter(&mut self, _closed: bool) -> Result<Option<Kelvin>, DriverError> {
        Err(gone())
    }

    async fn start(&mut self) -> Result<(), DriverError> {
        Ok(())
    }

    async fn frame(&mut self, _deadline: Duration) -> Result<Frame, DriverError> {
        self.0.pop_front().unwrap_or_else(|| Err(gone()))
    }

    async fn stop(&mut self) -> Result<(), DriverError> {
        Ok(())
    }

    async fn make_safe(&mut self) -> Result<(), DriverError> {
        Ok(())
    }
}

fn gone() -> DriverError {
    let text = |text: &str| text.to_owned();
    DriverError::lost(text("scripted"), text("x"), text("the end"), text("none"))
}

#[tokio::test]
async fn troubles_of_the_camera_behind_show_on_the_wire() {
    let frame = |id, complete| {
        let counts: Vec<u16> = expected(id);
        Ok(Frame { id, device_ns: 1000 * id, rows: 8, columns: 64, counts: counts.into(), complete })
    };
    let script = VecDeque::from([frame(40, true), frame(43, true), frame(44, false)]);
    let messages = Arc::new(Mutex::new(Vec::new()));
    let sink = Arc::clone(&messages);
    let server = GigeCamera::new(Box::new(Scripted(script)), SENSOR)
        .log(move |message| sink.lock().expect("no test panics with it").push(message.to_owned()))
        .serve_at("127.0.0.1:0".parse().unwrap())
        .await
        .unwrap();
    let mut client = Client::in_control(&server).await;
    assert_eq!(client.set_double("ExposureTime", 25.0).await, SUCCESS);
    assert_eq!(client.set("AcquisitionStart", 1).await, SUCCESS);
    let ids: Vec<_> =
        [client.block().await, client.block().await].into_iter().map(|block| block.id).collect();
    // Two frames lost by the camera itself are two ids missing.
    assert_eq!(ids, [1, 4]);
    let half = client.block().await;
    assert_eq!((half.id, half.is_whole(), half.payload.len()), (5, false, 0));
    client.resend(ResendRange { block: 5, first: 2, last: 2 }).await;
    assert_eq!(client.packet().await.status, UNAVAILABLE);
    // Then it is gone: the stream ends, the owner is told, the register shows what was taken.
    let end = || messages.lock().expect("no test panics with it").iter().any(|text| text.contains("the end"));
    until("the message", end).await;
    assert!((client.get_double("ExposureTime").await - 50.0).abs() < 1e-9);
    assert_eq!(server.stats().frames_missing, 2);
    // A refused act is an error on the control channel.
    assert_eq!(client.set("ShutterClosed", 1).await, 0x8FFF);
}
