//! The tables of a scene file as TOML has them, unchecked.

use super::media::CfdSource;
use crate::scene::spray::description::{HollowCone, MultiHole, SpraySource};
use serde::Deserialize;
use std::path::PathBuf;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneTables {
    #[serde(default)]
    pub(super) schema: Option<u32>,
    pub(super) camera: Option<CameraTable>,
    pub(super) plate: Option<PlateTable>,
    pub(super) walls: Option<WallTable>,
    pub(super) chamber: Option<ChamberTable>,
    #[serde(default)]
    pub(super) wall: Vec<SideTable>,
    pub(super) lab: Option<LabTable>,
    pub(super) exposure: Option<ExposureTable>,
    #[serde(default)]
    pub(super) window: Vec<WindowTable>,
    pub(super) band: Option<BandTable>,
    #[serde(default)]
    pub(super) medium: Media,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraTable {
    pub(super) kind: CameraKind,
    pub(super) position_m: [f64; 3],
    pub(super) look_at_m: [f64; 3],
    pub(super) up: [f64; 3],
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) horizontal_fov_deg: Option<f64>,
    pub(super) width_m: Option<f64>,
    #[serde(default)]
    pub(super) pixel_filter: FilterKind,
    pub(super) lens: Option<LensTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LensTable {
    pub(super) f_number: Option<f64>,
    pub(super) focal_length_m: Option<f64>,
    pub(super) aperture_m: Option<f64>,
    pub(super) numerical_aperture: Option<f64>,
    pub(super) focus_m: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ExposureTable {
    pub(super) time_s: f64,
    pub(super) velocity_m_s: Option<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum CameraKind {
    Pinhole,
    Telecentric,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub(super) enum FilterKind {
    #[default]
    Box,
    Centre,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlateTable {
    pub(super) shape: PlateKind,
    pub(super) centre_m: Option<[f64; 3]>,
    pub(super) facing: [f64; 3],
    pub(super) width_m: Option<f64>,
    pub(super) height_m: Option<f64>,
    pub(super) diameter_m: Option<f64>,
    pub(super) half_angle_deg: Option<f64>,
    pub(super) temperature_k: Option<f64>,
    /// Temperatures of which images are wanted.
    #[serde(default)]
    pub(super) temperatures_k: Vec<f64>,
    /// A number, or a file of wavelength_um and emissivity.
    pub(super) emissivity: Option<NumberOrFile>,
    pub(super) mirrors: Option<PlateMirrors>,
    pub(super) non_uniformity_k: Option<f64>,
    pub(super) non_uniformity_npy: Option<PathBuf>,
}

/// What a plate that is not black mirrors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlateMirrors {
    /// The walls.
    Walls,
    /// The laboratory.
    Laboratory,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum PlateKind {
    Rectangle,
    Disc,
    Cone,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WallTable {
    pub(super) temperature_k: f64,
    #[serde(default = "one")]
    pub(super) emissivity: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ChamberTable {
    pub(super) lower_m: [f64; 3],
    pub(super) upper_m: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SideTable {
    pub(super) side: Side,
    pub(super) temperature_k: Option<f64>,
    pub(super) emissivity: Option<f64>,
}

/// The walls in the order of [`crate::tracer::chamber::SIDE_NAMES`].
#[derive(Deserialize, Clone, Copy)]
pub(super) enum Side {
    #[serde(rename = "x-")]
    LowerX,
    #[serde(rename = "x+")]
    UpperX,
    #[serde(rename = "y-")]
    LowerY,
    #[serde(rename = "y+")]
    UpperY,
    #[serde(rename = "z-")]
    LowerZ,
    #[serde(rename = "z+")]
    UpperZ,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LabTable {
    pub(super) temperature_k: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WindowTable {
    pub(super) position_m: [f64; 3],
    pub(super) normal: [f64; 3],
    pub(super) material: String,
    pub(super) thickness_m: f64,
    pub(super) temperature_k: f64,
    pub(super) diameter_m: Option<f64>,
    pub(super) mirrors: Option<WindowMirrors>,
}

#[derive(Deserialize, Clone, Copy, PartialEq)]
#[serde(rename_all = "kebab-case")]
pub(super) enum WindowMirrors {
    Walls,
    Chamber,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BandTable {
    pub(super) wavelength_um: Option<f64>,
    pub(super) response: Option<PathBuf>,
    pub(super) samples: Option<SamplesChoice>,
}

/// A number, or the word "auto".
#[derive(Deserialize)]
#[serde(untagged)]
pub(super) enum SamplesChoice {
    Number(usize),
    Word(String),
}

/// `[medium]` or `[[medium]]`.
#[derive(Default)]
pub(super) struct Media(pub(super) Vec<MediumTable>);

impl<'de> Deserialize<'de> for Media {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> serde::de::Visitor<'de> for Visitor {
            type Value = Media;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a table [medium] or tables [[medium]]")
            }
            fn visit_map<A: serde::de::MapAccess<'de>>(self, map: A) -> Result<Media, A::Error> {
                let table = MediumTable::deserialize(serde::de::value::MapAccessDeserializer::new(map))?;
                Ok(Media(vec![table]))
            }
            fn visit_seq<A: serde::de::SeqAccess<'de>>(self, mut seq: A) -> Result<Media, A::Error> {
                let mut list = Vec::new();
                while let Some(table) = seq.next_element()? {
                    list.push(table);
                }
                Ok(Media(list))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub(super) enum MediumTable {
    Grid(GridTable),
    Slab(SlabTable),
    Sphere(RoundTable),
    Cylinder(RoundTable),
    Gaussian(GaussianTable),
    Box(BoxTable),
    Cfd(CfdSource),
    MultiHole(SpraySource<MultiHole>),
    HollowCone(SpraySource<HollowCone>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GridTable {
    pub(super) extinction_npy: PathBuf,
    pub(super) lower_m: [f64; 3],
    pub(super) upper_m: [f64; 3],
    pub(super) albedo: NumberOrFile,
    pub(super) temperature_k: Option<NumberOrFile>,
    #[serde(default)]
    pub(super) phase: PhaseChoice,
}

#[derive(Deserialize)]
#[serde(untagged)]
pub(super) enum NumberOrFile {
    Number(f64),
    File(PathBuf),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SlabTable {
    pub(super) optical_depth: f64,
    pub(super) thickness_m: f64,
    pub(super) albedo: f64,
    pub(super) temperature_k: Option<f64>,
    #[serde(default)]
    pub(super) phase: PhaseChoice,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RoundTable {
    pub(super) centre_m: [f64; 3],
    pub(super) radius_m: f64,
    pub(super) extinction: f64,
    pub(super) axis: Option<[f64; 3]>,
    pub(super) albedo: f64,
    pub(super) temperature_k: Option<f64>,
    #[serde(default)]
    pub(super) phase: PhaseChoice,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GaussianTable {
    pub(super) centre_m: [f64; 3],
    pub(super) width_m: f64,
    pub(super) extinction: f64,
    pub(super) albedo: f64,
    pub(super) temperature_k: Option<f64>,
    #[serde(default)]
    pub(super) phase: PhaseChoice,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BoxTable {
    pub(super) lower_m: [f64; 3],
    pub(super) upper_m: [f64; 3],
    pub(super) extinction: f64,
    pub(super) albedo: f64,
    pub(super) temperature_k: Option<f64>,
    #[serde(default)]
    pub(super) phase: PhaseChoice,
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub(super) enum PhaseChoice {
    // With braces: of a variant without them serde would take any keys and forget them.
    Isotropic {},
    HenyeyGreenstein {
        asymmetry: f64,
        /// Half angle of the cone that counts as unscattered.
        truncate_deg: Option<f64>,
    },
    Table {
        file: PathBuf,
        truncate_deg: Option<f64>,
    },
}

impl Default for PhaseChoice {
    fn default() -> Self {
        Self::Isotropic {}
    }
}

fn one() -> f64 {
    1.0
}
