//! What a camera offers: every feature with its kind, value, range and choices. Reads only. Blocks.

use crate::error::DriverError;
use aravis::glib::object::{Cast, IsA, ObjectExt};
use aravis::prelude::*;
use aravis::{
    Camera, Device, GcAccessMode, GcBoolean, GcCategory, GcCommand, GcEnumeration, GcFeatureNode, GcFloat,
    GcInteger, GcNode,
};
use serde::Serialize;
use std::collections::BTreeSet;

/// One feature.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Offered {
    /// Category it stands in.
    pub category: String,
    /// Name.
    pub name: String,
    /// `integer`, `float`, `boolean`, `enumeration`, `string`, `command`.
    pub kind: &'static str,
    /// Value at present; `None` when it cannot be read now.
    pub value: Option<String>,
    /// Lowest and highest value of a number.
    pub range: Option<(f64, f64)>,
    /// Choices of an enumeration.
    pub choices: Vec<String>,
    /// Whether it can be written at present.
    pub writable: bool,
    /// Unit of a number, where the camera says so.
    pub unit: Option<String>,
}

/// A limit beyond this is none.
const UNLIMITED: f64 = 1e15;

/// Features that are looked at most: a camera has some hundreds.
const FEATURES_MAX: usize = 10_000;

/// Opens a camera, reads all its features, and lets it go.
///
/// # Errors
/// [`DriverError::Missing`] when nothing answers at the address.
pub fn probe(address: &str) -> Result<Vec<Offered>, DriverError> {
    let who = format!("camera at {address}");
    let missing = |why: &str| {
        DriverError::Missing {
        who: who.clone(),
        why: why.to_owned(),
        hint: "Check power, cable and address (`ditd devices` lists what answers), and that no other program controls it."
            .to_owned(),
    }
    };
    let camera = Camera::new(Some(address)).map_err(|error| missing(error.message()))?;
    let device = camera.device().ok_or_else(|| missing("it has no device"))?;
    let mut offered = Vec::new();
    let mut seen = BTreeSet::new();
    let mut open = vec!["Root".to_owned()];
    while let Some(category) = open.pop() {
        let Some(node) = device.feature(&category).and_then(|node| node.downcast::<GcCategory>().ok()) else {
            continue;
        };
        let mut below = Vec::new();
        for name in node.features() {
            if !seen.insert(name.to_string()) || offered.len() >= FEATURES_MAX {
                continue;
            }
            match device.feature(&name) {
                Some(node) if node.is::<GcCategory>() => below.push(name.to_string()),
                Some(node) => offered.extend(describe(&device, &category, &name, &node)),
                None => {}
            }
        }
        open.extend(below.into_iter().rev());
    }
    Ok(offered)
}

fn describe(device: &Device, category: &str, name: &str, node: &GcNode) -> Option<Offered> {
    let feature = node.downcast_ref::<GcFeatureNode>()?;
    let kind = kind_of(node);
    let implemented = feature.is_implemented().unwrap_or(false);
    if !implemented {
        return None;
    }
    // Aravis 0.8.26 calls features that are read and written write-only: reading is tried, whatever it says.
    let value =
        (kind != "command").then(|| feature.value_as_string().ok()).flatten().map(|text| text.to_string());
    let range = match kind {
        "integer" => device.integer_feature_bounds(name).ok().map(|(low, high)| (low as f64, high as f64)),
        "float" => device.float_feature_bounds(name).ok(),
        _ => None,
    };
    // What has no limit of its own has that of its register.
    let range = range.filter(|(low, high)| low.abs() < UNLIMITED && high.abs() < UNLIMITED);
    let choices = match kind {
        "enumeration" => device
            .dup_available_enumeration_feature_values_as_strings(name)
            .map(|words| words.into_iter().map(|word| word.to_string()).collect())
            .unwrap_or_default(),
        _ => Vec::new(),
    };
    let unit = node
        .dynamic_cast_ref::<GcFloat>()
        .and_then(GcFloatExt::unit)
        .map(|unit| unit.to_string())
        .filter(|unit| !unit.is_empty());
    let writable = matches!(device.feature_access_mode(name), GcAccessMode::Rw | GcAccessMode::Wo)
        && !feature.is_locked().unwrap_or(false);
    Some(Offered {
        category: category.to_owned(),
        name: name.to_owned(),
        kind,
        value,
        range,
        choices,
        writable,
        unit,
    })
}

fn kind_of(node: &impl IsA<GcNode>) -> &'static str {
    let node: &GcNode = node.upcast_ref();
    // An enumeration is an integer, too, for the library: the narrower kinds first.
    if node.is::<GcCommand>() {
        "command"
    } else if node.is::<GcEnumeration>() {
        "enumeration"
    } else if node.is::<GcBoolean>() {
        "boolean"
    } else if node.is::<GcInteger>() {
        "integer"
    } else if node.is::<GcFloat>() {
        "float"
    } else {
        "string"
    }
}
