//! The camera's description of itself (GenICam XML), written from the table of features.
//!
//! The standard's own registers (bootstrap, chunks) are fixed text; everything else follows from the table. Element order is that
//! of the GenApi schema 1.1.

use super::feature::{Access, Bound, Feature, Kind};
use super::presets::CHUNKS;
use std::fmt::Write;

/// The description.
pub(super) fn description(maker: &str, model: &str, features: &[Feature]) -> String {
    let mut out = String::with_capacity(32 * 1024);
    let (vendor, model_name) = (identifier(maker), identifier(model));
    put(&mut out, format_args!("<?xml version=\"1.0\" encoding=\"utf-8\"?>\n"));
    put(
        &mut out,
        format_args!(
            "<RegisterDescription ModelName=\"{model_name}\" VendorName=\"{vendor}\" \
             ToolTip=\"Simulated infrared camera\" StandardNameSpace=\"GEV\" \
             SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" SchemaSubMinorVersion=\"0\" \
             MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" \
             ProductGuid=\"5d1f4a0e-63c7-4a4e-9a53-0e7c1d5b7a10\" VersionGuid=\"5d1f4a0e-63c7-4a4e-9a53-0e7c1d5b7a11\" \
             xmlns=\"http://www.genicam.org/GenApi/Version_1_1\">\n"
        ),
    );
    categories(features, &mut out);
    out.push_str(STANDARD);
    for feature in features {
        write_feature(feature, features, &mut out);
    }
    if features.iter().any(|feature| feature.name == "ChunkModeActive") {
        chunks(&mut out);
    }
    out.push_str("</RegisterDescription>\n");
    out
}

fn put(out: &mut String, text: std::fmt::Arguments<'_>) {
    out.write_fmt(text).expect("writing to a String cannot fail");
}

/// Letters, digits and underscores only: what the schema takes as a name.
fn identifier(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect()
}

/// Features of the fixed text by category.
const STANDARD_CATEGORIES: &[(&str, &[&str])] = &[
    (
        "DeviceControl",
        &[
            "DeviceVendorName",
            "DeviceModelName",
            "DeviceVersion",
            "DeviceFirmwareVersion",
            "DeviceManufacturerInfo",
            "DeviceSerialNumber",
            "DeviceUserID",
        ],
    ),
    ("ImageFormatControl", &[]),
    ("AcquisitionControl", &[]),
    ("CorrectionControl", &[]),
    ("ChunkDataControl", &[]),
    (
        "TransportLayerControl",
        &[
            "GevVersionMajor",
            "GevVersionMinor",
            "GevCurrentIPAddress",
            "GevHeartbeatTimeout",
            "GevTimestampTickFrequency",
            "GevTimestampControlLatch",
            "GevTimestampControlReset",
            "GevTimestampValue",
            "GevCCP",
            "GevStreamChannelSelector",
            "GevSCPHostPort",
            "GevSCPSFireTestPacket",
            "GevSCPSDoNotFragment",
            "GevSCPSPacketSize",
            "GevSCPD",
            "GevSCDA",
            "GevSCSP",
            "GevGVSPExtendedIDMode",
        ],
    ),
];

/// Chunk features, whose nodes [`chunks`] writes.
const CHUNK_FEATURES: [&str; 3] = ["ChunkFrameID", "ChunkExposureTime", "ChunkTimestamp"];

fn categories(features: &[Feature], out: &mut String) {
    let members = |category: &str, standard: &[&'static str]| -> Vec<&'static str> {
        let own = features.iter().filter(|f| f.category == category).map(|f| f.name);
        let mut all: Vec<_> = standard.iter().copied().chain(own).collect();
        if category == "ChunkDataControl" && !all.is_empty() {
            all.extend(CHUNK_FEATURES);
        }
        all
    };
    out.push_str("<Category Name=\"Root\" NameSpace=\"Standard\">\n");
    for (category, standard) in STANDARD_CATEGORIES {
        if !members(category, standard).is_empty() {
            put(out, format_args!("  <pFeature>{category}</pFeature>\n"));
        }
    }
    out.push_str("</Category>\n");
    for (category, standard) in STANDARD_CATEGORIES {
        let members = members(category, standard);
        if members.is_empty() {
            continue;
        }
        put(out, format_args!("<Category Name=\"{category}\" NameSpace=\"Standard\">\n"));
        for name in members {
            put(out, format_args!("  <pFeature>{name}</pFeature>\n"));
        }
        out.push_str("</Category>\n");
    }
}

fn write_feature(feature: &Feature, all: &[Feature], out: &mut String) {
    let name = feature.name;
    let node = match feature.kind {
        Kind::Integer { .. } => "Integer",
        Kind::Float { .. } => "Float",
        Kind::Enumeration(_) => "Enumeration",
        Kind::Boolean => "Boolean",
        Kind::Command => "Command",
    };
    put(out, format_args!("<{node} Name=\"{name}\" NameSpace=\"Custom\">\n"));
    if !feature.text.is_empty() {
        put(out, format_args!("  <ToolTip>{}</ToolTip>\n", feature.text));
    }
    let visibility = if feature.category.is_empty() { "Invisible" } else { "Beginner" };
    put(out, format_args!("  <Visibility>{visibility}</Visibility>\n"));
    if feature.access == Access::Locked {
        out.push_str("  <pIsLocked>AcquisitionLock</pIsLocked>\n");
    }
    let access = match feature.access {
        Access::ReadOnly => "RO",
        Access::WriteOnly => "WO",
        Access::ReadWrite | Access::Locked => "RW",
    };
    match &feature.kind {
        Kind::Integer { min, max, inc } => {
            put(out, format_args!("  <pValue>{name}Reg</pValue>\n"));
            write_bound("Min", *min, out);
            write_bound("Max", *max, out);
            put(out, format_args!("  <Inc>{inc}</Inc>\n"));
        }
        Kind::Float { min, max, inc, unit } => {
            put(
                out,
                format_args!("  <pValue>{name}Reg</pValue>\n  <Min>{min:?}</Min>\n  <Max>{max:?}</Max>\n"),
            );
            if let Some(inc) = inc {
                put(out, format_args!("  <Inc>{inc:?}</Inc>\n"));
            }
            put(out, format_args!("  <Unit>{unit}</Unit>\n"));
        }
        Kind::Enumeration(entries) => {
            for (entry, value) in entries {
                put(
                    out,
                    format_args!(
                        "  <EnumEntry Name=\"{entry}\" NameSpace=\"Custom\"><Value>{value}</Value></EnumEntry>\n"
                    ),
                );
            }
            put(out, format_args!("  <pValue>{name}Reg</pValue>\n"));
        }
        Kind::Boolean => {
            put(
                out,
                format_args!(
                    "  <pValue>{name}Reg</pValue>\n  <OnValue>1</OnValue>\n  <OffValue>0</OffValue>\n"
                ),
            );
        }
        Kind::Command => {
            put(out, format_args!("  <pValue>{name}Reg</pValue>\n  <CommandValue>1</CommandValue>\n"));
        }
    }
    if matches!(feature.kind, Kind::Enumeration(_)) {
        for selected in all.iter().filter(|other| other.selector == Some(name)) {
            put(out, format_args!("  <pSelected>{}</pSelected>\n", selected.name));
        }
    }
    put(out, format_args!("</{node}>\n"));
    write_register(feature, access, out);
}

fn write_bound(tag: &str, bound: Bound, out: &mut String) {
    match bound {
        Bound::Value(value) => put(out, format_args!("  <{tag}>{value}</{tag}>\n")),
        Bound::Feature(name) => put(out, format_args!("  <p{tag}>{name}</p{tag}>\n")),
    }
}

fn write_register(feature: &Feature, access: &str, out: &mut String) {
    let float = matches!(feature.kind, Kind::Float { .. });
    let node = if float { "FloatReg" } else { "IntReg" };
    let sign = if float { "" } else { "  <Sign>Unsigned</Sign>\n" };
    put(
        out,
        format_args!(
            "<{node} Name=\"{}Reg\" NameSpace=\"Custom\">\n  <Address>0x{:X}</Address>\n  <Length>{}</Length>\n  \
             <AccessMode>{access}</AccessMode>\n  <pPort>Device</pPort>\n  <Cachable>NoCache</Cachable>\n{sign}  \
             <Endianess>BigEndian</Endianess>\n</{node}>\n",
            feature.name,
            feature.address,
            feature.kind.bytes(),
        ),
    );
}

fn chunks(out: &mut String) {
    for ((name, id), feature) in CHUNKS.into_iter().zip(CHUNK_FEATURES) {
        put(out, format_args!("<Port Name=\"Chunk{name}Port\" NameSpace=\"Custom\">\n"));
        put(out, format_args!("  <ChunkID>{id:08X}</ChunkID>\n</Port>\n"));
        let (node, register, sign) = if name == "ExposureTime" {
            ("Float", "FloatReg", "")
        } else {
            ("Integer", "IntReg", "  <Sign>Unsigned</Sign>\n")
        };
        put(
            out,
            format_args!(
                "<{node} Name=\"{feature}\" NameSpace=\"Standard\">\n  <Visibility>Beginner</Visibility>\n  \
                 <pValue>{feature}Reg</pValue>\n</{node}>\n\
                 <{register} Name=\"{feature}Reg\" NameSpace=\"Custom\">\n  <Address>0</Address>\n  \
                 <Length>8</Length>\n  <AccessMode>RO</AccessMode>\n  <pPort>Chunk{name}Port</pPort>\n  \
                 <Cachable>NoCache</Cachable>\n{sign}  <Endianess>BigEndian</Endianess>\n</{register}>\n"
            ),
        );
    }
}

/// Nodes of the standard's own registers.
const STANDARD: &str = include_str!("standard.xml");

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::gige::presets::{Preset, Sensor};
    use std::collections::BTreeSet;

    const SENSOR: Sensor = Sensor { rows: 512, columns: 640, bits: 14, shutter: true };

    fn all() -> Vec<(Preset, String)> {
        [Preset::Generic, Preset::Flir, Preset::Telops]
            .into_iter()
            .map(|preset| (preset, description("ditd", "simulated <camera>", &preset.features(SENSOR))))
            .collect()
    }

    /// Tags of a text without CDATA and comments, in order: name, and whether it opens, closes, or both.
    fn tags(text: &str) -> Vec<(String, bool, bool)> {
        let mut tags = Vec::new();
        for part in text.split('<').skip(1) {
            let inside = part.split('>').next().unwrap_or_default();
            if inside.starts_with('?') {
                continue;
            }
            let closes = inside.starts_with('/');
            let both = inside.ends_with('/');
            let name = inside.trim_matches('/').split_whitespace().next().unwrap_or_default();
            tags.push((name.to_owned(), !closes, closes || both));
        }
        tags
    }

    #[test]
    fn every_opened_element_is_closed() {
        for (preset, text) in all() {
            let mut open = Vec::new();
            for (name, opens, closes) in tags(&text) {
                if opens {
                    open.push(name.clone());
                }
                if closes {
                    assert_eq!(open.pop(), Some(name), "{preset:?}");
                }
            }
            assert!(open.is_empty(), "{preset:?}: {open:?}");
            assert_eq!(text.matches('<').count(), text.matches('>').count());
            assert!(text.is_ascii());
        }
    }

    /// Every reference (pValue, pFeature, pMax, …) names a node, and no node is there twice.
    #[test]
    fn every_reference_has_its_node() {
        for (preset, text) in all() {
            let mut nodes = BTreeSet::new();
            for part in text.split(" Name=\"").skip(1) {
                let name = part.split('"').next().unwrap();
                // Entries of enumerations have names of their own.
                let entry = part.starts_with(&format!("{name}\" NameSpace=\"Custom\"><Value>"));
                assert!(entry || nodes.insert(name.to_owned()), "{preset:?}: {name} twice");
            }
            for part in text.split("<p").skip(1) {
                let (tag, rest) = part.split_once('>').unwrap();
                let target = rest.split('<').next().unwrap();
                let tag = tag.split_whitespace().next().unwrap();
                assert!(nodes.contains(target), "{preset:?}: p{tag} → {target}");
            }
        }
    }

    #[test]
    fn makes_differ_where_they_should() {
        let texts = all();
        let has = |index: usize, name: &str| texts[index].1.contains(&format!(" Name=\"{name}\""));
        assert!(has(0, "ExposureTime") && !has(1, "ExposureTime") && has(1, "PS0IntegrationTime"));
        assert!(has(1, "CorrectionPerform") && !has(0, "CorrectionPerform") && !has(2, "CorrectionPerform"));
        assert!(has(2, "AcquisitionArm") && has(2, "TDCStatus") && !has(0, "AcquisitionArm"));
        assert!(has(0, "ChunkFrameID") && !has(1, "ChunkFrameID"));
        assert!(has(0, "Mono14") && has(1, "Mono14") && !has(2, "Mono14"));
    }
}
