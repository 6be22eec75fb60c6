//! Builds the simulated world of a `[rig]` table: spray → coefficients → operators at several densities → world.
//!
//! Heavy (it renders) and pure: no clock, no tokio; files come through a function that the caller hands in.

use super::chamber::{World, WorldParts};
use super::config::{
    FilterConfig, RigConfig, Sampling, SamplingWord, SprayConfig, SpraySource, WindowConfig,
};
use super::radiometry::{Enclosure, Optics, PlateSurfaceSpectrum, Spectrum, WindowSpectrum};
use super::sights::{ScaleNode, Sights};
use crate::light::air::{AirError, AirPath, Atmosphere};
use crate::light::band::{Absorbers, Band, BandError, Response};
use crate::light::fuel::{Fuel, FuelError};
use crate::light::window::{Plate as WindowPlate, WindowError};
use crate::rig::RigError;
use crate::scene::compact;
use crate::scene::deposit::{self, DepositOptions};
use crate::scene::field::{CfdSpray, SprayField};
use crate::scene::file::{self, MediumSource};
use crate::scene::import::{self, ImportOptions, SceneError, Time};
use crate::scene::library::{self, OwnFile};
use crate::scene::optics::{self, Source, Species, Strength};
use crate::scene::spray as parametric_spray;
use crate::scene::spray::description::{Injector, SpraySource as ParametricSource};
use crate::tracer::camera::{Camera, PixelFilter, Projection};
use crate::tracer::error::TracerError;
use crate::tracer::image::{RenderOptions, render_image};
use crate::tracer::medium::GridMedium;
use crate::tracer::plate::PlateShape;
use std::path::Path;

/// The spray that is part of the program.
pub const EMBEDDED: &str = compact::SHIPPED;

/// Largest error of band emissivities that automatic sampling admits.
const EMISSIVITY_ERROR: f64 = 1e-3;

/// Why a world cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The description.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// The spray.
    #[error("simulated rig: reading the spray: {0}")]
    Scene(#[from] SceneError),
    /// The filter.
    #[error("simulated rig: the filter: {0}")]
    Band(#[from] BandError),
    /// The fuel.
    #[error("simulated rig: the fuel: {0}")]
    Fuel(#[from] FuelError),
    /// The rendering.
    #[error("simulated rig: rendering: {0}")]
    Tracer(#[from] TracerError),
}

/// What the camera stands in front of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// The bare plate: no chamber, no windows, no spray.
    Bench,
    /// The plate through the chamber.
    Chamber,
}

/// Builds the world that `config` describes. `folder` is where relative paths start; `progress` is told what is
/// being done and how far it is (0 … 1).
///
/// # Errors
///
/// [`BuildError`] naming what cannot be used.
pub fn world(
    config: &RigConfig,
    view: View,
    seed: u64,
    folder: &Path,
    progress: &(dyn Fn(&str, f64) + Sync),
) -> Result<World, BuildError> {
    config.validate()?;
    let band = band(config, folder)?;
    let groups = band.wavelengths_um.len();
    let spectrum = Spectrum { wavelengths_um: band.wavelengths_um.clone(), weights: band.weights.clone() };
    let plate = PlateSurfaceSpectrum {
        emissivity: vec![config.plate_view.emissivity; groups],
        lab_temperature_k: config.plate_view.lab_temperature_k,
    };
    let chamber = config.chamber.as_ref().filter(|_| view == View::Chamber);
    let optics = match chamber {
        None => Optics::bench(spectrum, plate, &config.detector)?,
        Some(chamber) => {
            let window = |window: Option<&WindowConfig>| {
                window_spectrum(window, &band, chamber.wall_temperature_k, folder)
            };
            let enclosure = Enclosure {
                near: window(config.window.as_ref().map(|both| &both.near))?,
                far: window(config.window.as_ref().map(|both| &both.far))?,
                gas_temperature_k: chamber.gas_temperature_k,
                wall_temperature_k: chamber.wall_temperature_k,
                wall_emissivity: chamber.wall_emissivity,
                window_fraction: chamber.window_fraction,
            };
            Optics::chamber(spectrum, plate, enclosure, &config.detector)?
        }
    };
    let sights = match (chamber, &config.spray) {
        (Some(_), Some(spray)) => spray_sights(config, spray, &band, seed, folder, progress)?,
        _ => {
            let pixels = config.view.rows * config.view.columns;
            Sights::empty(config.view.rows, config.view.columns, vec![1.0; pixels])?
        }
    };
    Ok(World::new(WorldParts {
        optics,
        sights,
        detector: config.detector.clone(),
        fluctuation: config.fluctuation.filter(|_| chamber.is_some()),
        residual: chamber.and_then(|chamber| chamber.residual),
        seed,
    })?)
}

/// The files of the user's own fuel and windows, read and checked; `folder` is where relative paths start.
///
/// # Errors
///
/// [`BuildError`] naming the key or file and what is wrong.
pub fn own_files(config: &RigConfig, folder: &Path) -> Result<Vec<OwnFile>, BuildError> {
    let mut files = Vec::new();
    if let Some(spray) = &config.spray {
        files.extend(library::fuel_and_files(&spray.fuel, folder)?.1);
        if let SpraySource::Scene(path) = &spray.source {
            parametric(spray, path, folder)?;
            let text = std::fs::read_to_string(folder.join(path))
                .map_err(|error| unusable_scene(path, &error.to_string()))?;
            files.push((path.clone(), text));
        }
    }
    for window in config.window.iter().flat_map(|both| [&both.near, &both.far]) {
        files.extend(library::material_and_file(&window.material, folder).map_err(material_error)?.1);
    }
    for file in &config.filter.response {
        files.push((file.clone(), response_file(file, folder)?.1));
    }
    files.sort();
    files.dedup();
    Ok(files)
}

fn material_error(error: WindowError) -> BuildError {
    RigError::Config { key: "rig.window.material".to_owned(), why: error.to_string() }.into()
}

/// A response table of the user's own, with its text.
fn response_file(file: &Path, folder: &Path) -> Result<(Response, String), BuildError> {
    let unusable = |why: String| RigError::Config {
        key: "rig.filter.response".to_owned(),
        why: format!("{}: {why}", file.display()),
    };
    let text = std::fs::read_to_string(folder.join(file)).map_err(|error| unusable(error.to_string()))?;
    let response = Response::from_csv(&text).map_err(|error| unusable(error.to_string()))?;
    Ok((response, text))
}

/// The response of camera, lens, filter and air: all that `filter` names, multiplied.
///
/// # Errors
///
/// [`BuildError`] naming the column or file that cannot be used.
pub fn response(filter: &FilterConfig, folder: &Path) -> Result<Response, BuildError> {
    let mut factors = Vec::new();
    let named: Vec<&str> = filter.detector.iter().chain(&filter.name).map(String::as_str).collect();
    if !named.is_empty() {
        factors.push(Response::shipped(&[named, vec!["lens_transmission_model"]].concat())?);
    }
    for file in &filter.response {
        factors.push(response_file(file, folder)?.0);
    }
    if let Some(air) = &filter.air {
        let unusable =
            |error: AirError| RigError::Config { key: "rig.filter.air".to_owned(), why: error.to_string() };
        let atmosphere = Atmosphere::named(&air.atmosphere).map_err(unusable)?;
        let (um, transmittance) = AirPath::new(atmosphere, air.length_m).map_err(unusable)?.curve();
        factors.push(Response::new(um, transmittance)?);
    }
    match factors.len() {
        // One curve stays as it is, to the bit.
        1 => Ok(factors.remove(0)),
        _ => Ok(Response::product(&factors)?),
    }
}

/// The wavelength samples of the filter, with its leak as samples of their own.
fn band(config: &RigConfig, folder: &Path) -> Result<Band, BuildError> {
    let response = response(&config.filter, folder)?;
    match config.filter.samples {
        Sampling::Number(samples) => Ok(Band::sample(&response, samples, true)?),
        Sampling::Word(SamplingWord::Automatic) => {
            // Without a spray nothing in front of the plate depends on the wavelength.
            let (fuel, absorbers) = match &config.spray {
                Some(spray) => (library::fuel(&spray.fuel, folder)?, Absorbers::BOTH),
                None => (Fuel::named("n-heptane")?, Absorbers::NONE),
            };
            Ok(Band::automatic_for(&response, &fuel, absorbers, EMISSIVITY_ERROR)?.band)
        }
    }
}

/// A window at the band's wavelengths; no window lets everything through.
fn window_spectrum(
    window: Option<&WindowConfig>,
    band: &Band,
    wall_temperature_k: f64,
    folder: &Path,
) -> Result<WindowSpectrum, BuildError> {
    let groups = band.wavelengths_um.len();
    let Some(window) = window else {
        return Ok(WindowSpectrum {
            transmittance: vec![1.0; groups],
            reflectance: vec![0.0; groups],
            absorptance: vec![0.0; groups],
            temperature_k: wall_temperature_k,
        });
    };
    let material = library::material(&window.material, folder).map_err(|error| RigError::Config {
        key: "rig.window.material".to_owned(),
        why: error.to_string(),
    })?;
    let plate = WindowPlate { material, thickness_m: window.thickness_m };
    let optics: Vec<_> =
        band.wavelengths_um.iter().map(|um| plate.optics(*um, window.temperature_k)).collect();
    Ok(WindowSpectrum {
        transmittance: optics.iter().map(|one| one.transmittance).collect(),
        reflectance: optics.iter().map(|one| one.reflectance).collect(),
        absorptance: optics.iter().map(|one| one.absorptance).collect(),
        temperature_k: window.temperature_k,
    })
}

fn spray_sights(
    config: &RigConfig,
    spray: &SprayConfig,
    band: &Band,
    seed: u64,
    folder: &Path,
    progress: &(dyn Fn(&str, f64) + Sync),
) -> Result<Sights, BuildError> {
    progress("reading the spray", 0.0);
    let fuel = library::fuel(&spray.fuel, folder)?;
    let field = field(spray, &fuel, folder)?;
    if library::is_file(&spray.fuel) {
        covers(&fuel, band)?;
    }
    let offset_k = spray.temperature_offset_k;
    let radiance = |species, offset_k| Source { species, strength: Strength::Radiance { offset_k } };
    let sources = [
        Source::UNIT,
        radiance(Species::All, 0.0),
        radiance(Species::All, -offset_k),
        radiance(Species::All, offset_k),
        Source { species: Species::Droplets, strength: Strength::Unit },
        radiance(Species::Droplets, 0.0),
    ];
    progress("cross-sections of droplets and vapour", 0.02);
    let options = optics::OpticsOptions { target_error: config.target_error };
    let medium = optics::medium(&field, &fuel, band, &sources, &options);
    let camera = camera(config);
    let plate = PlateShape::Disc {
        centre_m: config.plate_view.centre_m,
        facing: config.plate_view.facing,
        diameter_m: config.plate_view.diameter_m,
    };
    let nodes = spray.scales.len() as f64;
    let mut rendered = Vec::with_capacity(spray.scales.len());
    for (index, &scale) in spray.scales.iter().enumerate() {
        let text = format!("rays through the spray, density × {scale}");
        let begun = index as f64;
        let told = |done: f64| progress(&text, 0.05 + 0.95 * (begun + done) / nodes);
        let options = RenderOptions { target_error: config.target_error, seed, ..RenderOptions::default() };
        let operator = render_image(&scaled(&medium, scale), &camera, Some(&plate), &options, &told)?;
        rendered.push(ScaleNode { scale, operator });
    }
    Ok(Sights::new(rendered, offset_k)?)
}

/// A fuel of the user's own must be known where the filter lets light through; beside it, where only the filter's leak
/// is, the ends of its table will do.
fn covers(fuel: &Fuel, band: &Band) -> Result<(), RigError> {
    let [from, to] = fuel.liquid_range_um();
    let in_band = &band.wavelengths_um[..band.leak_from.unwrap_or(band.wavelengths_um.len())];
    match in_band.iter().find(|um| !(from..=to).contains(um)) {
        None => Ok(()),
        Some(um) => Err(RigError::Config {
            key: "rig.spray.fuel".to_owned(),
            why: format!(
                "the liquid's table of {} goes from {from} to {to} um; the filter also needs {um:.3} um",
                fuel.name()
            ),
        }),
    }
}

/// The spray on its grid.
fn field(spray: &SprayConfig, fuel: &Fuel, folder: &Path) -> Result<SprayField, BuildError> {
    if let SpraySource::Scene(path) = &spray.source {
        let mut source = parametric(spray, path, folder)?;
        source.cell_m = Some(spray.cell_m);
        source.time_s = spray.time_s.unwrap_or(source.time_s);
        // The rig makes shots itself.
        source.shot = None;
        return parametric_spray::spray(&source, fuel)
            .map(|made| made.field)
            .map_err(|why| unusable_scene(path, &why).into());
    }
    let options = DepositOptions { cell_m: Some(spray.cell_m), ..DepositOptions::default() };
    Ok(deposit::field(&read_spray(spray, folder)?, &options)?.0)
}

fn unusable_scene(path: &Path, why: &str) -> RigError {
    RigError::Config { key: "rig.spray.source".to_owned(), why: format!("{}: {why}", path.display()) }
}

/// What a scene file says about its parametric spray.
fn parametric(
    spray: &SprayConfig,
    path: &Path,
    folder: &Path,
) -> Result<ParametricSource<Injector>, BuildError> {
    let scene = file::load(&folder.join(path)).map_err(|error| unusable_scene(path, &error.to_string()))?;
    let Some(MediumSource::Parametric(source)) = scene.medium else {
        let why =
            "its [medium] is neither \"multi-hole\" nor \"hollow-cone\"; of a CFD spray give { path = … }";
        return Err(unusable_scene(path, why).into());
    };
    let beside = folder.join(path.parent().unwrap_or(Path::new("")));
    let same = if library::is_file(&spray.fuel) {
        folder.join(&spray.fuel) == beside.join(&source.spray.fuel)
    } else {
        spray.fuel == source.spray.fuel
    };
    if !same {
        return Err(RigError::Config {
            key: "rig.spray.fuel".to_owned(),
            why: format!("it is {:?} here and {:?} in {}", spray.fuel, source.spray.fuel, path.display()),
        }
        .into());
    }
    Ok(source.spray)
}

/// The spray's parcels and cells.
fn read_spray(spray: &SprayConfig, folder: &Path) -> Result<CfdSpray, BuildError> {
    match &spray.source {
        SpraySource::Scene(path) => {
            Err(unusable_scene(path, "a parametric spray has neither parcels nor CFD cells").into())
        }
        SpraySource::Embedded(name) if name == EMBEDDED => Ok(compact::shipped()?),
        SpraySource::Embedded(name) => Err(BuildError::Rig(RigError::Config {
            key: "rig.spray.source".to_owned(),
            why: format!("no embedded spray is called {name:?}; there is {EMBEDDED:?}"),
        })),
        SpraySource::Path(path) => {
            let time = spray.time_s.map_or(Time::Latest, Time::At);
            Ok(import::read(&folder.join(path), time, &ImportOptions::default())?)
        }
    }
}

fn camera(config: &RigConfig) -> Camera {
    let view = &config.view;
    let projection = match (view.horizontal_fov_deg, view.width_m) {
        (Some(horizontal_fov_deg), _) => Projection::Pinhole { horizontal_fov_deg },
        // The check of the configuration leaves no third case.
        (None, width_m) => Projection::Telecentric { width_m: width_m.unwrap_or(0.0) },
    };
    Camera {
        projection,
        position_m: view.position_m,
        look_at_m: view.look_at_m,
        up: view.up,
        columns: view.columns,
        rows: view.rows,
        pixel_filter: PixelFilter::Box,
        lens: None,
    }
}

/// The same spray with all concentrations multiplied.
fn scaled(medium: &GridMedium, factor: f64) -> GridMedium {
    let times = |values: &[f64]| values.iter().map(|value| value * factor).collect();
    GridMedium {
        k_ext: times(&medium.k_ext),
        k_sca: times(&medium.k_sca),
        emission: times(&medium.emission),
        ..medium.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_own_fuel_must_cover_the_filter_but_not_its_leak() {
        let band = Band::sample(&Response::filtered_insb().unwrap(), 8, true).unwrap();
        assert!(band.leak_from.is_some());
        let fuel = |from: f64, to: f64| {
            let liquid = format!("wavelength_um,n,k\n{from},1.4,0.1\n{to},1.4,0.1\n");
            let density =
                crate::light::fuel::Density::from_csv("T_K,rho_liq_kg_m3\n280,700\n400,600\n").unwrap();
            Fuel::from_csv("own", "", &liquid, "wavelength_um,sigma_m2_mol_300K\n3,1\n4,1\n", 0.1, density)
                .unwrap()
        };
        assert!(covers(&fuel(3.0, 3.9), &band).is_ok());
        let error = covers(&fuel(3.4, 3.9), &band).unwrap_err().to_string();
        assert!(error.contains("3.4 to 3.9 um"), "{error}");
    }

    use crate::rig::config::AirConfig;

    fn filter(name: Option<&str>, detector: Option<&str>, response: &[&str]) -> FilterConfig {
        FilterConfig {
            name: name.map(str::to_owned),
            detector: detector.map(str::to_owned),
            response: response.iter().map(Into::into).collect(),
            air: None,
            samples: Sampling::Word(SamplingWord::Automatic),
        }
    }

    #[test]
    fn tables_of_ones_own_are_multiplied_with_the_named_columns() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("own.csv"), "wavelength_um,response\n3.3,0\n3.4,0.8\n3.5,0\n")
            .unwrap();
        std::fs::write(folder.path().join("air.csv"), "wavelength_um,response\n3,0.9\n4,0.7\n").unwrap();
        let of = |filter: &FilterConfig| response(filter, folder.path());
        let own = of(&filter(None, None, &["own.csv"])).unwrap();
        assert!((own.at(3.42) - 0.64).abs() < 1e-14);
        let all = of(&filter(None, Some("QE_InSb_model"), &["own.csv", "air.csv"])).unwrap();
        let camera = Response::shipped(&["QE_InSb_model", "lens_transmission_model"]).unwrap();
        assert!((all.at(3.42) - 0.64 * 0.816 * camera.at(3.42)).abs() < 1e-14);
        // Air takes its part of every wavelength; what there is no curve for is refused.
        let through = AirPath::new(Atmosphere::UsStandard, 1.5).unwrap().transmittance(1e4 / 2925.0);
        let air = |atmosphere: &str, length_m| FilterConfig {
            air: Some(AirConfig { atmosphere: atmosphere.to_owned(), length_m }),
            ..filter(None, None, &["own.csv"])
        };
        let behind = of(&air("us-standard", 1.5)).unwrap();
        let um = 1e4 / 2925.0;
        assert!(
            (behind.at(um) / own.at(um) - through).abs() < 1e-12,
            "{} {through}",
            behind.at(um) / own.at(um)
        );
        assert!(of(&air("martian", 1.0)).unwrap_err().to_string().contains("us-standard"));
        assert!(of(&air("us-standard", -1.0)).is_err());
        // As before there were tables.
        let named = of(&filter(Some("filter_3.40_fwhm0.12"), Some("QE_InSb_model"), &[])).unwrap();
        assert_eq!(named, Response::filtered_insb().unwrap());
        let message = |filter: &FilterConfig| of(filter).unwrap_err().to_string();
        assert!(message(&filter(None, None, &["none.csv"])).contains("none.csv"));
        std::fs::write(folder.path().join("bad.csv"), "wavelength_um,response\n3.3,1\n3.2,1\n").unwrap();
        assert!(message(&filter(None, None, &["bad.csv"])).contains("bad.csv"));
    }
}
