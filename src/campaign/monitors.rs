//! Process values during a campaign: read with the plate, held against their limits.
//!
//! Knows neither journal nor telemetry: whoever reads writes them down.

use ditd_drivers::error::DriverError;
use ditd_drivers::instrument::{Monitor, MonitorReading};

/// One source of process values.
pub struct MonitorLine {
    /// Its name in the telemetry.
    pub name: String,
    /// Whether the campaign ends when it cannot be read.
    pub required: bool,
    /// Its values, in their order.
    pub values: Vec<Watched>,
    /// The driver.
    pub source: Box<dyn Monitor>,
}

/// One value and its limits.
#[derive(Debug, Clone, PartialEq)]
pub struct Watched {
    /// Name with its unit.
    pub name: String,
    /// Least value that is allowed.
    pub low: Option<f64>,
    /// Greatest value that is allowed.
    pub high: Option<f64>,
}

/// A value outside of its limits.
#[derive(Debug, Clone, PartialEq)]
pub struct Exceeded {
    /// Monitor and value.
    pub name: String,
    /// What it is.
    pub value: f64,
    /// `above` or `below`.
    pub side: &'static str,
    /// The limit.
    pub limit: f64,
}

/// All sources of a rig.
#[derive(Default)]
pub struct Monitors {
    lines: Vec<MonitorLine>,
    /// Sources that could not be read the last time, so that it is told once.
    silent: Vec<bool>,
}

/// What one round of readings gave.
#[derive(Debug, Default)]
pub(super) struct Round {
    /// Values under their full names, monitor and value; those that could not be read are missing.
    pub(super) values: Vec<MonitorReading>,
    /// What the operator should know.
    pub(super) notes: Vec<String>,
    /// The first value outside of its limits.
    pub(super) exceeded: Option<Exceeded>,
}

impl Monitors {
    /// The sources of a rig.
    pub fn new(lines: Vec<MonitorLine>) -> Self {
        let silent = vec![false; lines.len()];
        Self { lines, silent }
    }

    /// Full names of all values: the columns that they have in the telemetry.
    pub fn names(&self) -> Vec<String> {
        let each =
            self.lines.iter().flat_map(|line| line.values.iter().map(|value| full_name(line, &value.name)));
        each.collect()
    }

    /// Reads every source once. An error when a required one cannot be read.
    pub(super) async fn read(&mut self) -> Result<Round, DriverError> {
        let mut round = Round::default();
        for (line, silent) in self.lines.iter_mut().zip(&mut self.silent) {
            let readings = match line.source.read().await {
                Ok(readings) => readings,
                Err(error) if line.required => return Err(error),
                Err(error) => {
                    if !*silent {
                        round.notes.push(format!("monitor {} is not read: {error}", line.name));
                    }
                    *silent = true;
                    continue;
                }
            };
            if *silent {
                round.notes.push(format!("monitor {} is read again", line.name));
                *silent = false;
            }
            for reading in readings {
                let watched = line.values.iter().find(|value| value.name == reading.name);
                let name = full_name(line, &reading.name);
                if round.exceeded.is_none() {
                    round.exceeded = watched.and_then(|watched| watched.judge(&name, reading.value));
                }
                round.values.push(MonitorReading { name, value: reading.value });
            }
        }
        Ok(round)
    }
}

fn full_name(line: &MonitorLine, value: &str) -> String {
    format!("{}.{value}", line.name)
}

impl Watched {
    fn judge(&self, name: &str, value: f64) -> Option<Exceeded> {
        let out = |side, limit| Some(Exceeded { name: name.to_owned(), value, side, limit });
        // Written so that what is no number is outside of any limit.
        match (self.low, self.high) {
            (Some(low), _) if value.is_nan() || value < low => out("below", low),
            (_, Some(high)) if value.is_nan() || value > high => out("above", high),
            _ => None,
        }
    }
}

impl std::fmt::Debug for Monitors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Monitors").field("names", &self.names()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::future::ready;
    use std::pin::Pin;

    struct Scripted(Vec<Option<f64>>);

    type Given = Result<Vec<MonitorReading>, DriverError>;

    impl Monitor for Scripted {
        fn read<'a, 'b>(&'a mut self) -> Pin<Box<dyn Future<Output = Given> + Send + 'b>>
        where
            'a: 'b,
            Self: 'b,
        {
            let gone = || DriverError::Missing {
                who: "gauge".to_owned(),
                why: "gone".to_owned(),
                hint: String::new(),
            };
            let reading = |value| vec![MonitorReading { name: "wall_temperature_k".to_owned(), value }];
            Box::pin(ready(self.0.remove(0).map(reading).ok_or_else(gone)))
        }
    }

    fn monitors(required: bool, script: &[Option<f64>]) -> Monitors {
        let watched = Watched { name: "wall_temperature_k".to_owned(), low: Some(500.0), high: Some(540.0) };
        Monitors::new(vec![MonitorLine {
            name: "chamber".to_owned(),
            required,
            values: vec![watched],
            source: Box::new(Scripted(script.to_vec())),
        }])
    }

    #[tokio::test]
    async fn a_value_at_its_limit_is_allowed_and_beyond_it_is_named() {
        let mut monitors = monitors(true, &[Some(500.0), Some(540.0), Some(540.1), Some(499.9)]);
        for side in [None, None, Some("above"), Some("below")] {
            let round = monitors.read().await.unwrap();
            assert_eq!(round.exceeded.as_ref().map(|exceeded| exceeded.side), side, "{round:?}");
            assert_eq!(round.values[0].name, "chamber.wall_temperature_k");
        }
    }

    #[tokio::test]
    async fn a_required_one_that_is_gone_is_an_error_and_another_is_told_once() {
        assert!(monitors(true, &[None]).read().await.is_err());
        let mut optional = monitors(false, &[None, None, Some(520.0), None]);
        for (values, notes) in [(0, 1), (0, 0), (1, 1), (0, 1)] {
            let round = optional.read().await.unwrap();
            assert_eq!((round.values.len(), round.notes.len()), (values, notes), "{round:?}");
        }
    }
}
