//! The forms of the correlations that `sim/data/fuels/fits.csv` and `nitrogen_fits.csv` use.

use crate::light::table::{Records, TableError};

/// How a property follows from the temperature; τ = 1 − T/T_c, T_r = T/T_c, t = T/1000 K.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// p = p_c exp((T_c/T)(aτ + bτ^1.5 + cτ^2.5 + dτ⁵)): Wagner's equation.
    Wagner,
    /// a + bτ^0.35 + cτ^(2/3) + dτ + eτ^(4/3).
    Density,
    /// exp(a) τ^(b + cT_r + dT_r²): 0 at the critical point as long as the exponent there is above 0.
    Power,
    /// exp(a + b/T + c ln T + dT + eT²).
    Exponential,
    /// a + bt + ct² + dt³ + et⁴.
    Polynomial,
    /// a (T/300 K)^1.75, at 1 bar.
    Diffusivity,
}

impl Form {
    /// The form that a fit table's column `form` writes out.
    fn of_text(text: &str) -> Option<Self> {
        Some(match text {
            "ln(p/pc)=(Tc/T)*(a*tau+b*tau^1.5+c*tau^2.5+d*tau^5)" => Self::Wagner,
            "a+b*tau^0.35+c*tau^(2/3)+d*tau+e*tau^(4/3)" => Self::Density,
            "exp(a)*tau^(b+c*Tr+d*Tr^2)" | "exp(a)*tau^(b+c*Tr)" => Self::Power,
            "exp(a+b/T+c*ln(T)+d*T+e*T^2)" => Self::Exponential,
            "sum a_i*(T/1000)^i" | "sum a_i*(T/1000)^i (fitted at 4 bar)" => Self::Polynomial,
            "a*(T/300)^1.75*(1e5/p_Pa)" => Self::Diffusivity,
            _ => return None,
        })
    }
}

/// One property of one fluid over temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correlation {
    /// Its form.
    pub form: Form,
    /// a … e in the property's SI unit; absent ones are 0.
    pub coefficients: [f64; 5],
    /// T_c in K; of no meaning for forms without τ.
    pub critical_k: f64,
    /// p_c in Pa; of no meaning but for [`Form::Wagner`].
    pub critical_pa: f64,
    /// Range of the fit in K.
    pub range_k: [f64; 2],
    /// Largest relative difference from the values that were fitted.
    pub fit_error: f64,
}

impl Correlation {
    /// The value at a temperature in K above 0, in the property's SI unit, without a look at the range. At and above
    /// the critical temperature τ counts as 0.
    pub fn at(&self, temperature_k: f64) -> f64 {
        let [a, b, c, d, e] = self.coefficients;
        let t = temperature_k;
        let reduced = t / self.critical_k;
        let tau = (1.0 - reduced).max(0.0);
        match self.form {
            Form::Wagner => {
                let root = tau.sqrt();
                let sum = tau * (a + b * root + c * tau * root + d * tau.powi(4));
                self.critical_pa * (sum / reduced).exp()
            }
            Form::Density => {
                let third = tau.cbrt();
                a + b * tau.powf(0.35) + c * third * third + d * tau + e * tau * third
            }
            Form::Power => a.exp() * tau.powf(b + reduced * (c + reduced * d)),
            Form::Exponential => (a + b / t + c * t.ln() + t * (d + t * e)).exp(),
            Form::Polynomial => {
                let t = 1e-3 * t;
                a + t * (b + t * (c + t * (d + t * e)))
            }
            Form::Diffusivity => a * (t / 300.0).powf(1.75),
        }
    }

    /// Reads the correlation in one row of a fit table.
    ///
    /// # Errors
    ///
    /// [`TableError`] with the row, also for an unknown form.
    pub(super) fn of_row(
        records: &Records<'_>,
        row: usize,
        error_column: &str,
        critical: [f64; 2],
    ) -> Result<Self, TableError> {
        let text = records.text(row, "form")?;
        let form = Form::of_text(text)
            .ok_or_else(|| TableError::Column { wanted: text.to_owned(), found: "other forms".to_owned() })?;
        let mut coefficients = [0.0; 5];
        for (coefficient, name) in coefficients.iter_mut().zip(["a", "b", "c", "d", "e"]) {
            if records.text(row, name).is_ok_and(|text| !text.is_empty()) {
                *coefficient = records.number(row, name)?;
            }
        }
        Ok(Self {
            form,
            coefficients,
            critical_k: critical[0],
            critical_pa: critical[1],
            range_k: [records.number(row, "T_min_K")?, records.number(row, "T_max_K")?],
            fit_error: records.number(row, error_column)?,
        })
    }
}
