//! `ditd render --shots`: an ensemble of shots out of one rendering of their mean.
//!
//! Paths are traced for the mean spray only; of each shot the sights are followed, with the light scattered into them
//! brought in line with its densities. Shot k is the one that `shot = k` in `[medium]` shows. Mean and standard deviation
//! are summed up as the shots come: no two of them are in memory at once.

use super::collected::{Collected, collected, gridded, render_options};
use super::columns::Views;
use super::image::{Images, camera_of, plate_temperatures, write_exr};
use super::pictures::{Picture, Scale, beside, kelvin_name};
use super::report::mean;
use super::{Args, IMAGE_TARGET, count};
use crate::commands::{CommandError, CommandResult, print};
use ditd_sim::scene::file::{MediumSource, Scene};
use ditd_sim::scene::mirror::Mirror;
use ditd_sim::tracer::camera::Camera;
use ditd_sim::tracer::image::render_shots;
use ditd_sim::tracer::operator::Operator;
use std::fmt::Write as _;
use std::path::Path;

/// Shots of one command: fewer have no standard deviation, more are more files than anybody looks at.
const SHOTS: std::ops::RangeInclusive<u32> = 2..=10_000;

/// Refuses what has no shots before any spray is made.
///
/// # Errors
///
/// Status 2, with what to change.
pub(super) fn check(scene: &Scene, number: u32) -> Result<(), CommandError> {
    let refuse = |problem: &str| Err(CommandError::usage(format!("render: --shots: {problem}")));
    if !SHOTS.contains(&number) {
        return refuse(&format!(
            "{number} shots; give {} to {} of them, or for a single one shot = 1 in [medium]",
            SHOTS.start(),
            SHOTS.end()
        ));
    }
    let Some(MediumSource::Parametric(source)) = &scene.medium else {
        return refuse(
            "the scene's medium does not fluctuate: only sprays of [medium] kind = \"multi-hole\" or \"hollow-cone\" \
             have shots. Take one of these, or leave out --shots",
        );
    };
    if let Some(shot) = source.spray.shot {
        return refuse(&format!(
            "[medium] shot = {shot} is one shot already, and shots differ from the mean. Leave out `shot` in the scene"
        ));
    }
    let law = source.spray.shots;
    if law.turbulence <= 0.0 && law.mass <= 0.0 && law.angle_deg <= 0.0 {
        return refuse(
            "[medium.shots] turbulence, mass and angle_deg are all 0, so that all shots are the mean. Raise one of them, or \
             leave out --shots",
        );
    }
    if Mirror::of(scene).is_some() {
        return refuse(
            "[[window]] mirrors = \"chamber\": what a shot looks like in a mirror is not followed. Leave out `mirrors`",
        );
    }
    if scene.plate.as_ref().is_some_and(|plate| plate.deviation.is_some()) {
        return refuse(
            "[plate] non_uniformity: an uneven plate behind shots is not followed. Leave out the non-uniformity",
        );
    }
    Ok(())
}

/// Renders the mean spray and follows its shots.
///
/// # Errors
///
/// Status 2 for a scene that cannot be rendered, 1 where a file cannot be written.
pub(super) fn images(scenes: Vec<(f64, Scene)>, number: u32, args: &Args) -> CommandResult {
    let mut scenes = scenes.into_iter();
    let (Some((_, mut scene)), None) = (scenes.next(), scenes.next()) else {
        return Err(CommandError::usage(
            "render: --shots: the spray moves by pixels during the [exposure], and shots are of one moment. Shorten \
             [exposure] time_s, or leave it out",
        ));
    };
    let temperatures_k = plate_temperatures(&mut scene, args)?;
    let camera = camera_of(&scene)?;
    let plate = scene.plate.as_ref().map(|p| p.shape.clone());
    let walls = scene.surroundings(&temperatures_k);
    let views = Views::new(&mut scene, &temperatures_k, args, walls)?;
    let options = render_options(&scene, walls, args.target_error.unwrap_or(IMAGE_TARGET), args);
    let (Some(medium), Some(law)) = (gridded(&scene), scene.shots.clone()) else {
        return Err(CommandError::usage("render: --shots: the spray has no cells. Check its time and size"));
    };
    let law = args.seed.map_or(law.clone(), |seed| law.with_seed(seed));
    let mut ensemble = Ensemble::new(views, &scene, &camera, number, args);
    let mut outcome = Ok(());
    let mut take = |operator: Operator| {
        if outcome.is_ok() {
            outcome = ensemble.take(&collected(&operator, walls));
        }
    };
    let mut factors = (1..=u64::from(number)).map(|shot| law.factors(shot));
    render_shots(medium, &camera, plate.as_ref(), &options, &mut factors, &mut take, &|_| {})
        .map_err(|e| CommandError::usage(format!("render: {e}")))?;
    outcome?;
    ensemble.finish()
}

/// What has been seen of the shots.
struct Ensemble<'a> {
    views: Views,
    scene: &'a Scene,
    camera: &'a Camera,
    number: u32,
    args: &'a Args,
    /// Known once the mean spray has come.
    begun: Option<Begun>,
    channels: Vec<(String, Moments)>,
    pictures: Vec<(Option<f64>, Moments)>,
    shots: Vec<Shot>,
}

/// Figures of the mean spray's rendering, and the scale of the pictures if any are wanted.
struct Begun {
    stats: Vec<(String, f64)>,
    scale: Option<Scale>,
}

/// Figures of one shot.
struct Shot {
    sights: f64,
    paths: f64,
    /// Mean over the image of each channel.
    means: Vec<f64>,
}

impl<'a> Ensemble<'a> {
    fn new(views: Views, scene: &'a Scene, camera: &'a Camera, number: u32, args: &'a Args) -> Self {
        let (channels, pictures, shots) = (Vec::new(), Vec::new(), Vec::new());
        Self { views, scene, camera, number, args, begun: None, channels, pictures, shots }
    }

    /// Takes the mean spray first, then shot after shot.
    fn take(&mut self, collected: &Collected) -> Result<(), CommandError> {
        let (channels, pictures) = self.views.images(collected);
        let Some(Begun { scale, .. }) = &self.begun else {
            // Shots are shown on the scale of the mean spray: no two would compare otherwise.
            let scale = self.args.png.as_ref().map(|_| Scale::of(self.scene, &pictures)).transpose()?;
            self.begun = Some(Begun { stats: collected.stats.clone(), scale });
            self.channels =
                channels.into_iter().map(|(name, values)| (name, Moments::new(values.len()))).collect();
            self.pictures = pictures.into_iter().map(|p| (p.name, Moments::new(p.values.len()))).collect();
            return Ok(());
        };
        let shot = self.shots.len() + 1;
        let stat = |name: &str| collected.stats.iter().find(|(n, _)| n == name).map_or(0.0, |(_, v)| *v);
        self.shots.push(Shot {
            sights: stat("sights"),
            paths: stat("paths"),
            means: channels.iter().map(|(_, values)| mean(values)).collect(),
        });
        for ((_, moments), (_, values)) in self.channels.iter_mut().zip(&channels) {
            moments.add(values.iter().map(|&v| f64::from(v)));
        }
        let name = format!("shot{shot:0width$}", width = self.number.to_string().len());
        if let Some(out) = &self.args.out {
            write(&beside(out, &name), self.camera, &Images { channels, stats: Vec::new() })?;
        }
        for ((_, moments), picture) in self.pictures.iter_mut().zip(&pictures) {
            moments.add(picture.values.iter().copied());
            if let (Some(png), Some(scale)) = (&self.args.png, scale) {
                let path = png_path(png, picture.name, pictures.len(), Some(&name));
                scale.write(
                    &path,
                    self.camera,
                    &picture.title(&format!("radiance, shot {shot}")),
                    &picture.values,
                )?;
            }
        }
        Ok(())
    }

    /// Writes mean and standard deviation, and reports.
    fn finish(self) -> CommandResult {
        let Some(Begun { stats, scale }) = self.begun else {
            return Err(CommandError::failure("render: --shots: nothing was rendered"));
        };
        let names: Vec<String> = self.channels.iter().map(|(name, _)| name.clone()).collect();
        let mut channels: Vec<(String, Vec<f32>)> =
            self.channels.iter().map(|(name, moments)| (name.clone(), single(&moments.mean))).collect();
        // The spread of standard errors tells nothing.
        let shown = self.channels.iter().filter(|(name, _)| !name.starts_with("se_"));
        channels.extend(shown.map(|(name, moments)| (format!("sd_{name}"), single(&moments.deviation()))));
        let images = Images { channels, stats };
        if let Some(out) = &self.args.out {
            write(out, self.camera, &images)?;
        }
        if let (Some(png), Some(scale)) = (&self.args.png, scale) {
            let deviations: Vec<Picture> = self
                .pictures
                .iter()
                .map(|(name, moments)| Picture { name: *name, values: moments.deviation() })
                .collect();
            let of_deviations = Scale::of(self.scene, &deviations)?;
            let several = deviations.len();
            for ((name, moments), deviation) in self.pictures.iter().zip(&deviations) {
                let title = |what: &str| deviation.title(&format!("{what} of {} shots", self.number));
                let path = png_path(png, *name, several, None);
                scale.write(&path, self.camera, &title("mean radiance"), &moments.mean)?;
                let path = png_path(png, *name, several, Some("sd"));
                of_deviations.write(&path, self.camera, &title("standard deviation"), &deviation.values)?;
            }
        }
        report(&images, &names, &self.shots, self.args.json)
    }
}

fn write(path: &Path, camera: &Camera, images: &Images) -> Result<(), CommandError> {
    write_exr(path, camera, images)
        .map_err(|e| CommandError::failure(format!("render: writing {}: {e}", path.display())))
}

/// The picture of a plate temperature, if there are several, and of a shot.
fn png_path(path: &Path, kelvin: Option<f64>, several: usize, addition: Option<&str>) -> std::path::PathBuf {
    let kelvin = kelvin.filter(|_| several > 1).map(kelvin_name);
    let named: Vec<&str> = kelvin.as_deref().into_iter().chain(addition).collect();
    if named.is_empty() { path.to_owned() } else { beside(path, &named.join("_")) }
}

#[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
fn single(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}

/// Mean and spread of images, pixel by pixel (Welford 1962).
struct Moments {
    count: f64,
    mean: Vec<f64>,
    squares: Vec<f64>,
}

impl Moments {
    fn new(pixels: usize) -> Self {
        Self { count: 0.0, mean: vec![0.0; pixels], squares: vec![0.0; pixels] }
    }

    fn add(&mut self, values: impl Iterator<Item = f64>) {
        self.count += 1.0;
        for ((mean, squares), value) in self.mean.iter_mut().zip(&mut self.squares).zip(values) {
            let difference = value - *mean;
            *mean += difference / self.count;
            *squares += difference * (value - *mean);
        }
    }

    /// Standard deviation of one shot, with n − 1; NaN of fewer than two.
    fn deviation(&self) -> Vec<f64> {
        let others = (self.count - 1.0).max(0.0);
        self.squares.iter().map(|squares| (squares / others).sqrt()).collect()
    }
}

fn report(images: &Images, names: &[String], shots: &[Shot], json: bool) -> CommandResult {
    let sum = |of: fn(&Shot) -> f64| shots.iter().map(of).sum::<f64>();
    let mut all = images.stats.clone();
    all.push(("shots".to_owned(), count(shots.len())));
    all.push(("shots_sights".to_owned(), sum(|shot| shot.sights)));
    all.push(("shots_paths".to_owned(), sum(|shot| shot.paths)));
    all.extend(images.channels.iter().map(|(name, values)| (format!("mean_{name}"), mean(values))));
    let numbered = || (1..).zip(shots);
    if json {
        let mut map: serde_json::Map<String, serde_json::Value> =
            all.into_iter().map(|(name, value)| (name, serde_json::json!(value))).collect();
        let list: Vec<serde_json::Value> = numbered()
            .map(|(number, shot): (u32, _)| {
                let mut one =
                    serde_json::json!({ "shot": number, "sights": shot.sights, "paths": shot.paths });
                for (name, mean) in names.iter().zip(&shot.means) {
                    one[format!("mean_{name}")] = serde_json::json!(mean);
                }
                one
            })
            .collect();
        map.insert("shot_list".to_owned(), list.into());
        return print(&format!("{}\n", serde_json::Value::Object(map)));
    }
    let mut text: String = all.iter().map(|(name, value)| format!("{name:24} {value}\n")).collect();
    let first = |shot: &Shot| {
        names.iter().zip(&shot.means).take(3).map(|(n, m)| format!("{n} {m:.5}")).collect::<Vec<_>>()
    };
    for (number, shot) in numbered() {
        let _ = writeln!(text, "{:24} {}", format!("shot_{number}: mean"), first(shot).join(", "));
    }
    print(&text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_values() {
        let mut moments = Moments::new(2);
        for shot in [[1.0, 1e9 + 1.0], [2.0, 1e9 + 2.0], [6.0, 1e9 + 6.0]] {
            moments.add(shot.into_iter());
        }
        assert!((moments.mean[0] - 3.0).abs() < 1e-14 && (moments.mean[1] - 1e9 - 3.0).abs() < 1e-6);
        // (4 + 1 + 9)/2; subtracting squares would leave nothing of the second.
        assert!(moments.deviation().iter().all(|d| (d - 7.0_f64.sqrt()).abs() < 1e-6));
        assert!(Moments::new(1).deviation()[0].is_nan());
    }

    #[test]
    fn pictures_are_named_by_temperature_and_shot() {
        let name = |kelvin, several, addition| {
            png_path(Path::new("d.1/a.png"), kelvin, several, addition).to_string_lossy().into_owned()
        };
        assert_eq!(name(None, 1, None), "d.1/a.png");
        assert_eq!(name(Some(400.0), 1, Some("sd")), "d.1/a_sd.png");
        assert_eq!(name(Some(400.5), 2, Some("shot03")), "d.1/a_400_5K_shot03.png");
    }
}
