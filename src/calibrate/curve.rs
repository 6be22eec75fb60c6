//! The standard curve from its points, and today's short one mapped on it.

use super::points::Series;
use super::{CalibrateError, Calibration, Figures, Key, Mapping};
use crate::config::Config;
use crate::estimate::calibration::{
    CalibrationError, CalibrationFit, CalibrationPoint, OffsetMode, Passband, fit_curve, fit_curve_in_band,
    map_on_fit,
};

/// The standard curve through a series. With a shutter the offset, its drift and the camera's own light are gone from the
/// points; what remains is I(T) − I(T_shutter) and the plate's mirrored laboratory, a constant: so the offset is fitted
/// all the same, and the shutter's own temperature is one more point, at zero counts.
///
/// # Errors
///
/// [`CalibrateError::Fit`] when the points follow no curve.
pub fn standard(series: &Series, config: &Config, utc: &str) -> Result<Calibration, CalibrateError> {
    let mut points = series.points.clone();
    if let Some(cold) = series.shutter_k {
        let quietest = points.iter().map(|point| point.sigma_counts).fold(f64::INFINITY, f64::min);
        points.insert(0, CalibrationPoint { temperature_k: cold, counts: 0.0, sigma_counts: quietest });
    }
    let fit = fit_points(&points, config.optics.passband.as_ref())
        .map_err(|error| CalibrateError::Fit(error.to_string()))?;
    Ok(Calibration {
        mapping: None,
        schema: 1,
        utc: utc.to_owned(),
        key: Key::of(config),
        // Without a shutter, what the curve says of no light.
        dark_counts: series.dark_counts.unwrap_or(fit.offset_counts),
        points,
        fit,
        figures: Figures::default(),
    })
}

fn fit_points(
    points: &[CalibrationPoint],
    band: Option<&Passband>,
) -> Result<CalibrationFit, CalibrationError> {
    match band {
        Some(band) => fit_curve_in_band(points, OffsetMode::Free, band),
        None => fit_curve(points, OffsetMode::Free),
    }
}

/// Today's calibration from its own points and an older standard curve of the same camera, lens and filter: the paper's
/// mapping. Another integration time goes into the gain, the camera's offset into the offset.
///
/// # Errors
///
/// [`CalibrateError::Key`] for another region or number of bits, [`CalibrateError::Fit`] when the points do not follow the
/// standard curve.
pub fn today(measured: &Calibration, standard: &Calibration) -> Result<Calibration, CalibrateError> {
    let like = Key { integration_s: measured.key.integration_s, ..standard.key.clone() };
    if like != measured.key {
        return Err(CalibrateError::Key { made: standard.key.to_string(), used: measured.key.to_string() });
    }
    let line = map_on_fit(&standard.fit, &measured.points)
        .map_err(|error| CalibrateError::Fit(error.to_string()))?;
    let curve = line.curve(&standard.fit.curve);
    let mut covariance = standard.fit.covariance;
    // ln A gets the gain's relative variance; the offset is today's own.
    covariance[0][0] += line.covariance[0][0] / (line.gain * line.gain);
    covariance.iter_mut().for_each(|row| row[3] = 0.0);
    covariance[3] = [0.0; 4];
    let cross = line.covariance[0][1] / line.gain;
    (covariance[0][3], covariance[3][0], covariance[3][3]) = (cross, cross, line.covariance[1][1]);
    let residual =
        |point: &CalibrationPoint| point.counts - curve.value(point.temperature_k) - line.offset_counts;
    let drift = line.gain * standard.key.integration_s / measured.key.integration_s - 1.0;
    Ok(Calibration {
        fit: CalibrationFit {
            curve,
            offset_counts: line.offset_counts,
            covariance,
            chi2: line.chi2,
            dof: line.dof,
            // A correction of temperatures: another gain leaves it as it is.
            residual: standard.fit.residual.clone(),
            range: standard.fit.range,
            residuals: measured.points.iter().map(residual).collect(),
            iterations: 0,
        },
        mapping: Some(Mapping {
            standard_utc: standard.utc.clone(),
            standard_integration_s: standard.key.integration_s,
            age_days: age_days(&standard.utc, &measured.utc),
            drift,
            line,
        }),
        ..measured.clone()
    })
}

/// Days between two UTC stamps.
fn age_days(from: &str, to: &str) -> Option<f64> {
    let stamp = |text: &str| text.parse::<jiff::Timestamp>().ok().map(|t| t.as_second() as f64);
    Some((stamp(to)? - stamp(from)?) / 86_400.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::Figures;
    use crate::estimate::calibration::SakumaHattori;

    const CURVE: SakumaHattori = SakumaHattori { a_counts: 7.2e5, a_um: 3.4, b_um_k: 1.5 };

    fn calibration(gain: f64, offset: f64, integration_s: f64, utc: &str) -> Calibration {
        let points: Vec<CalibrationPoint> = [340.0, 390.0, 440.0, 490.0, 540.0]
            .into_iter()
            .map(|temperature_k| CalibrationPoint {
                temperature_k,
                counts: gain * CURVE.value(temperature_k) + offset,
                sigma_counts: 0.1,
            })
            .collect();
        let fit = fit_curve(&points, OffsetMode::Free).unwrap();
        let key = Key {
            rows: 4,
            columns: 5,
            integration_s,
            bits: 14,
            camera: None,
            lens: None,
            filter: None,
            gain: None,
        };
        Calibration {
            schema: 1,
            utc: utc.into(),
            key,
            dark_counts: 1500.0,
            points,
            fit,
            mapping: None,
            figures: Figures::default(),
        }
    }

    /// 25 µs to 20 µs, an offset, and no alarm; a changed gain and age raise theirs; another region is refused.
    #[test]
    fn a_short_curve_is_mapped_on_the_standard_one() {
        let standard = calibration(1.0, 0.0, 25e-6, "2026-01-01T00:00:00Z");
        let short = calibration(0.8, 4.0, 20e-6, "2026-02-01T00:00:00Z");
        let mapped = today(&short, &standard).unwrap();
        let mapping = mapped.mapping.clone().unwrap();
        assert!((mapping.line.gain - 0.8).abs() < 1e-6 && mapping.drift.abs() < 1e-6);
        assert!((mapping.age_days.unwrap() - 31.0).abs() < 1e-9 && mapping.alarms().is_empty());
        assert!((mapped.fit.offset_counts - 4.0).abs() < 1e-5);
        for t in [350.0, 450.0, 530.0] {
            assert!((mapped.fit.curve.inverse(0.8 * CURVE.value(t)) - t).abs() < 1e-3);
            // The gain's uncertainty is there, beside the standard curve's own.
            assert!(mapped.fit.sigma_counts(t) > 0.8 * standard.fit.sigma_counts(t) * 0.999);
        }
        let json = serde_json::to_string(&mapped).unwrap();
        assert_eq!(serde_json::from_str::<Calibration>(&json).unwrap().mapping, mapped.mapping);
        let fouled = today(&calibration(0.9, 0.0, 25e-6, "2027-01-01T00:00:00Z"), &standard).unwrap();
        assert_eq!(fouled.mapping.unwrap().alarms().len(), 2);
        let mut other = short;
        other.key.rows = 9;
        assert!(matches!(today(&other, &standard), Err(CalibrateError::Key { .. })));
    }
}
