//! The quirks of the makes.

use super::*;
use crate::rig::gige::pattern::{SHUTTER_COUNT, pattern_count};

async fn make(preset: Preset) -> (GigeServer, Client) {
    let server = camera(|camera| camera.preset(preset)).await;
    let client = Client::in_control(&server).await;
    (server, client)
}

#[tokio::test]
async fn flir_shifts_mono16_and_names_milliseconds() {
    let (server, mut client) = make(Preset::Flir).await;
    assert_eq!(client.set_double("PS0IntegrationTime", 0.025).await, SUCCESS);
    assert_eq!(client.set("SyncSource", 2).await, SUCCESS);
    for (frame, format, scale) in [(0, 0x0110_0007, 4), (1, 0x0110_0025, 1)] {
        assert_eq!(client.set("PixelFormat", format).await, SUCCESS);
        assert_eq!(client.set("AcquisitionStart", 1).await, SUCCESS);
        assert_eq!(client.set("SyncSoftware", 1).await, SUCCESS);
        let block = client.block().await;
        assert_eq!(block.samples()[65], scale * pattern_count(frame, 1, 1));
        assert_eq!(client.set("AcquisitionStop", 1).await, SUCCESS);
    }
    assert!((client.get_double("PS0IntegrationTime").await - 0.025).abs() < 1e-12);
    assert_eq!(server.stats().spoilings, 0);
}

#[tokio::test]
async fn flir_factory_gain_is_gone_for_ever() {
    let (server, mut client) = make(Preset::Flir).await;
    assert_eq!(client.set("PixelFormat", 0x0110_0025).await, SUCCESS);
    assert_eq!(client.set("SyncSource", 2).await, SUCCESS);
    assert_eq!(client.set("CorrectionPerform", 1).await, SUCCESS);
    assert_eq!(client.set("AcquisitionStart", 1).await, SUCCESS);
    for frame in 0..2 {
        assert_eq!(client.set("SyncSoftware", 1).await, SUCCESS);
        assert_eq!(client.block().await.samples()[0], pattern_count(frame, 0, 0) / 2 + 1000);
    }
    assert_eq!(server.stats().spoilings, 1);
}

#[tokio::test]
async fn flir_left_on_temperatures_sends_no_counts() {
    let server = camera(|camera| camera.preset(Preset::Flir).initial("IRFormat", 2.0)).await;
    let mut client = Client::in_control(&server).await;
    assert_eq!(client.get("IRFormat").await, 2);
    assert_eq!(client.set("SyncSource", 2).await, SUCCESS);
    assert_eq!(client.set("AcquisitionStart", 1).await, SUCCESS);
    assert_eq!(client.set("SyncSoftware", 1).await, SUCCESS);
    assert_eq!(client.block().await.samples()[0], 30_000 + pattern_count(0, 0, 0));
}

#[tokio::test]
async fn telops_has_two_rows_more_and_waits_to_be_armed() {
    let (_server, mut client) = make(Preset::Telops).await;
    assert_eq!((client.get("Height").await, client.get("SensorHeight").await), (10, 8));
    assert_eq!(client.get("PayloadSize").await, 64 * 10 * 2);
    assert_eq!(client.get("TDCStatus").await, 1 << 8);
    assert_eq!(client.set("AcquisitionArm", 1).await, SUCCESS);
    assert_eq!(client.get("TDCStatus").await, 0);
    // Triggers of another kind do not make frames.
    assert_eq!(client.set("TriggerSelector", 1).await, SUCCESS);
    assert_eq!(client.set("TriggerMode", 1).await, SUCCESS);
    assert_eq!(client.set("TriggerSource", 48).await, SUCCESS);
    assert_eq!(client.set("TriggerSelector", 0).await, SUCCESS);
    assert_eq!((client.get("TriggerMode").await, client.get("TriggerSource").await), (0, 0));
    client.start_software().await;
    assert_eq!(client.get("TDCStatus").await, 1 << 10);
    let block = client.shot().await;
    let bytes = block.bytes();
    assert_eq!((&bytes[..2], bytes.len()), (&b"TC"[..], 64 * 10 * 2));
    let word = |at: usize| u32::from_le_bytes(*bytes[at..].first_chunk().unwrap());
    assert_eq!((word(8), word(24), word(32)), (1, 100_000, 64 | 8 << 16));
    assert_eq!(block.samples()[128], pattern_count(0, 0, 0));
}

#[tokio::test]
async fn warm_cameras_are_busy() {
    let hour = Duration::from_secs(3600);
    let server = camera(|camera| camera.preset(Preset::Telops).cool_down(hour)).await;
    let mut client = Client::in_control(&server).await;
    assert_eq!(client.get("TDCStatus").await, 0b11 | 1 << 8);
    assert_eq!(client.get("DeviceNotReady").await, 1);
    assert_eq!(client.set("AcquisitionStart", 1).await, 0x8007);
    assert!(client.get_double("DeviceTemperature").await > 10.0);
    let (_server, mut client) = make(Preset::Generic).await;
    assert!((client.get_double("DeviceTemperature").await + 196.15).abs() < 1e-9);
}

#[tokio::test]
async fn chunks_come_behind_the_image() {
    let (_server, mut client) = make(Preset::Generic).await;
    assert_eq!(client.set("ChunkModeActive", 1).await, SUCCESS);
    for selector in [0, 1] {
        assert_eq!(client.set("ChunkSelector", selector).await, SUCCESS);
        assert_eq!(client.set("ChunkEnable", 1).await, SUCCESS);
    }
    assert_eq!(client.set("ChunkSelector", 2).await, SUCCESS);
    assert_eq!(client.get("ChunkEnable").await, 0);
    assert_eq!(client.get("PayloadSize").await, 1024 + 8 + 2 * 16);
    assert_eq!(client.set_double("ExposureTime", 25.0).await, SUCCESS);
    client.start_software().await;
    let block = client.shot().await;
    let bytes = block.bytes();
    assert_eq!(bytes.len(), 1024 + 8 + 2 * 16);
    assert_eq!(block.leader.unwrap()[..4], [0, 0, 0x40, 1]);
    assert_eq!(bytes[1032..1040], 1_u64.to_be_bytes());
    let exposure = f64::from_be_bytes(*bytes[1048..].first_chunk().unwrap());
    assert!((exposure - 25.0).abs() < 1e-9);
}

#[tokio::test]
async fn closed_shutter_is_seen_and_has_a_temperature() {
    for (preset, feature) in
        [(Preset::Generic, "ShutterClosed"), (Preset::Flir, "FlagPosition"), (Preset::Telops, "ICUPosition")]
    {
        let (_server, mut client) = make(preset).await;
        assert_eq!(client.set(feature, 1).await, SUCCESS);
        assert_eq!(client.get(feature).await, 1);
        assert!((client.get_double("ShutterTemperature").await - 26.85).abs() < 1e-9);
        if preset == Preset::Generic {
            client.start_software().await;
            let all = client.shot().await.samples();
            assert!(all.iter().all(|&sample| sample == SHUTTER_COUNT));
            // It opens while the stream runs.
            assert_eq!(client.set(feature, 0).await, SUCCESS);
            assert_eq!(client.shot().await.samples()[0], pattern_count(1, 0, 0));
        }
    }
}
