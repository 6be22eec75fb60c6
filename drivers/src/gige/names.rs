//! How cameras call the features that a campaign needs, and what each of them means by its value.
//!
//! The Standard Features Naming Convention (EMVA, SFNC) first; FLIR and Telops as read in the register names of their
//! own GenICam files. Every name can be replaced in the campaign file, since a standard feature may be missing. Pure.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Features that must never be written: FLIR's `CorrectionPerform` overwrites the factory gain of the camera.
pub const FORBIDDEN: &[&str] = &["CorrectionPerform"];

/// Whose habits a camera has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// The naming convention, and nothing else.
    #[default]
    Generic,
    /// FLIR A6xxx and X6xxx: exposure in ms in a preset register, `Mono16` = 4 × count.
    Flir,
    /// Telops: two rows of header above the picture, an arm command, the trigger starts the acquisition.
    Telops,
}

/// What a feature is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Purpose {
    /// Columns of the region.
    Width,
    /// Rows of the region.
    Height,
    /// First column of the region.
    OffsetX,
    /// First row of the region.
    OffsetY,
    /// Format of a pixel.
    PixelFormat,
    /// Integration time.
    Exposure,
    /// How frames are taken: without end.
    AcquisitionMode,
    /// Which trigger is meant.
    TriggerSelector,
    /// Trigger on or off.
    TriggerMode,
    /// Where the trigger comes from.
    TriggerSource,
    /// Which edge of it.
    TriggerActivation,
    /// Makes the camera ready before the acquisition starts.
    Arm,
    /// The internal shutter or flag, closed or open.
    Shutter,
    /// Temperature of the shutter, in °C.
    ShutterTemperature,
    /// A new offset correction with the closed shutter.
    OffsetCorrection,
}

/// A feature's name, and the value that it is given when the driver has no better one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feature {
    /// What it is for.
    pub purpose: Purpose,
    /// The camera's name for it.
    pub name: &'static str,
    /// The value that is always written, as text.
    pub value: Option<&'static str>,
    /// Whether a camera without it cannot be used.
    pub required: bool,
}

const fn feature(
    purpose: Purpose,
    name: &'static str,
    value: Option<&'static str>,
    required: bool,
) -> Feature {
    Feature { purpose, name, value, required }
}

const GENERIC: &[Feature] = &[
    feature(Purpose::AcquisitionMode, "AcquisitionMode", Some("Continuous"), false),
    feature(Purpose::PixelFormat, "PixelFormat", None, true),
    feature(Purpose::OffsetX, "OffsetX", None, false),
    feature(Purpose::OffsetY, "OffsetY", None, false),
    feature(Purpose::Width, "Width", None, true),
    feature(Purpose::Height, "Height", None, true),
    feature(Purpose::Exposure, "ExposureTime", None, true),
    feature(Purpose::TriggerSelector, "TriggerSelector", Some("FrameStart"), false),
    feature(Purpose::TriggerSource, "TriggerSource", Some("Line1"), true),
    feature(Purpose::TriggerActivation, "TriggerActivation", Some("RisingEdge"), false),
    feature(Purpose::TriggerMode, "TriggerMode", Some("On"), true),
    feature(Purpose::Shutter, "ShutterClosed", None, false),
    feature(Purpose::ShutterTemperature, "ShutterTemperature", None, false),
    feature(Purpose::OffsetCorrection, "NUCExecute", None, false),
];

/// Names that differ from the convention (pyflir 0.2.4: `PS0IntegrationTime` in ms, `CorrectionAuto*`).
const FLIR: &[Feature] = &[
    feature(Purpose::Exposure, "PS0IntegrationTime", None, true),
    // The trigger's names differ from model to model and no public source has them: the campaign file must name at least
    // the source; whether there is a mode and a selector besides is the camera's affair.
    feature(Purpose::TriggerMode, "TriggerMode", Some("On"), false),
    feature(Purpose::Shutter, "FlagPosition", None, false),
    feature(Purpose::OffsetCorrection, "CorrectionAutoPerform", None, false),
];

/// pyTelops 0.2.5: the selector is `AcquisitionStart`; `AcquisitionArm` comes before the start.
const TELOPS: &[Feature] = &[
    feature(Purpose::TriggerSelector, "TriggerSelector", Some("AcquisitionStart"), true),
    feature(Purpose::TriggerSource, "TriggerSource", Some("ExternalSignal"), true),
    feature(Purpose::Arm, "AcquisitionArm", None, true),
    feature(Purpose::Shutter, "ICUPosition", None, false),
    feature(Purpose::OffsetCorrection, "ImageCorrection", None, false),
];

/// What is written once, before everything else, with the preset's word for raw counts.
const RAW_COUNTS: &[(Preset, &str, &str)] = &[
    // Radiometric: counts; the others are temperatures of the camera's own calibration.
    (Preset::Flir, "IRFormat", "Radiometric"),
    // RAW: no gain, no calibration; the estimator makes its own flat.
    (Preset::Telops, "CalibrationMode", "RAW"),
];

/// The names of one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Names {
    preset: Preset,
    table: Vec<(Purpose, String, Option<&'static str>, bool)>,
}

impl Names {
    /// The preset's names, with those of `overrides` in their place.
    ///
    /// # Errors
    /// Names a feature that must never be written.
    pub fn new(preset: Preset, overrides: &BTreeMap<Purpose, String>) -> Result<Self, String> {
        let own: &[Feature] = match preset {
            Preset::Generic => &[],
            Preset::Flir => FLIR,
            Preset::Telops => TELOPS,
        };
        let mut table: Vec<_> = GENERIC
            .iter()
            .map(|f| own.iter().find(|other| other.purpose == f.purpose).unwrap_or(f))
            .collect();
        table.extend(own.iter().filter(|f| GENERIC.iter().all(|other| other.purpose != f.purpose)));
        let mut table: Vec<_> =
            table.into_iter().map(|f| (f.purpose, f.name.to_owned(), f.value, f.required)).collect();
        for (purpose, name) in overrides {
            refuse_forbidden(name)?;
            match table.iter_mut().find(|row| row.0 == *purpose) {
                Some(row) => row.1.clone_from(name),
                None => table.push((*purpose, name.clone(), None, true)),
            }
        }
        Ok(Self { preset, table })
    }

    /// The camera's name for a feature; `None` when it has none.
    pub fn of(&self, purpose: Purpose) -> Option<&str> {
        self.table.iter().find(|row| row.0 == purpose).map(|row| row.1.as_str())
    }

    /// The value that a feature is always given, as text.
    pub fn value_of(&self, purpose: Purpose) -> Option<&'static str> {
        self.table.iter().find(|row| row.0 == purpose).and_then(|row| row.2)
    }

    /// Whether a camera without the feature cannot be used.
    pub fn is_required(&self, purpose: Purpose) -> bool {
        self.table.iter().any(|row| row.0 == purpose && row.3)
    }

    /// What one unit of the exposure feature is, in seconds.
    pub fn exposure_unit_s(&self) -> f64 {
        match self.of(Purpose::Exposure) {
            // Whoever names a FLIR's standard feature means its standard unit.
            Some("PS0IntegrationTime") => 1e-3,
            _ => 1e-6,
        }
    }

    /// The feature and the word that make the camera send raw counts, where it has such a feature.
    pub fn raw_counts(&self) -> Option<(&'static str, &'static str)> {
        RAW_COUNTS.iter().find(|row| row.0 == self.preset).map(|row| (row.1, row.2))
    }

    /// What is written to the shutter's feature to open and to close it.
    pub fn shutter_words(&self) -> [&'static str; 2] {
        match self.preset {
            Preset::Generic => ["false", "true"],
            Preset::Flir => ["Open", "Closed"],
            Preset::Telops => ["Scene", "ICU"],
        }
    }

    /// Rows of header above the picture.
    pub fn header_rows(&self) -> usize {
        if self.preset == Preset::Telops { HEADER_ROWS_TELOPS } else { 0 }
    }

    /// Bits by which the counts of a 16-bit pixel are shifted up, for a sensor of `bits` bits.
    pub fn shift_mono16(&self, bits: u32) -> u32 {
        if self.preset == Preset::Flir { 16 - bits } else { 0 }
    }
}

/// pyTelops: two rows above every picture.
const HEADER_ROWS_TELOPS: usize = 2;

/// # Errors
/// Says why the feature is never written.
pub fn refuse_forbidden(name: &str) -> Result<(), String> {
    if FORBIDDEN.iter().any(|forbidden| forbidden.eq_ignore_ascii_case(name)) {
        return Err(format!(
            "{name} overwrites the camera's factory gain and is never written by this program"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(preset: Preset) -> Names {
        Names::new(preset, &BTreeMap::new()).unwrap()
    }

    #[test]
    fn presets_differ_where_the_makers_do() {
        assert_eq!(names(Preset::Generic).of(Purpose::Exposure), Some("ExposureTime"));
        assert_eq!(names(Preset::Flir).of(Purpose::Exposure), Some("PS0IntegrationTime"));
        assert!((names(Preset::Flir).exposure_unit_s() - 1e-3).abs() < 1e-15);
        assert_eq!(names(Preset::Flir).shift_mono16(14), 2);
        assert_eq!(names(Preset::Telops).shift_mono16(14), 0);
        assert_eq!(names(Preset::Telops).header_rows(), 2);
        assert_eq!(names(Preset::Telops).of(Purpose::Arm), Some("AcquisitionArm"));
        assert_eq!(names(Preset::Generic).of(Purpose::Arm), None);
        assert_eq!(names(Preset::Telops).value_of(Purpose::TriggerSelector), Some("AcquisitionStart"));
    }

    #[test]
    fn a_name_of_the_users_own_replaces_the_presets() {
        let own = BTreeMap::from([(Purpose::Exposure, "ExposureTime".to_owned())]);
        let names = Names::new(Preset::Flir, &own).unwrap();
        assert_eq!(names.of(Purpose::Exposure), Some("ExposureTime"));
        assert!((names.exposure_unit_s() - 1e-6).abs() < 1e-18);
        let own = BTreeMap::from([(Purpose::Arm, "correctionperform".to_owned())]);
        assert!(Names::new(Preset::Generic, &own).unwrap_err().contains("factory gain"));
    }

    #[test]
    fn no_preset_names_a_forbidden_feature() {
        for preset in [Preset::Generic, Preset::Flir, Preset::Telops] {
            for (_, name, _, _) in names(preset).table {
                assert_eq!(refuse_forbidden(&name), Ok(()));
            }
        }
    }
}
