//! Process values from an instrument that answers a line of text with a line of text.
//!
//! Which query, which field of the answer and which scale belong to each value; values with the same query share one
//! exchange. For loggers, indicators and controllers of the SCPI kind and older.

use super::{Scaled, number_in};
use crate::error::DriverError;
use crate::instrument::{Monitor, MonitorReading};
use crate::wire::{LineHabits, Tries, Wire, WireSettings};
use async_trait::async_trait;
use std::time::Duration;

/// Common bit rate of such instruments; the configuration says another.
const BAUD: u32 = 9600;

/// What ends a query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// CR.
    Cr,
    /// LF.
    Lf,
    /// CR LF.
    CrLf,
}

/// One value of an answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// The text that asks for it.
    pub query: String,
    /// Which field of the answer, from 0; fields are parted by commas, semicolons or, without any, by blanks.
    pub field: usize,
    /// What becomes of its number.
    pub value: Scaled,
}

/// The line settings when nothing is configured.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}

/// An instrument at the end of a wire.
#[derive(Debug)]
pub struct AsciiQuery {
    wire: Wire,
    fields: Vec<Field>,
}

impl AsciiQuery {
    /// A monitor over an open wire. Sends nothing.
    pub fn new(mut wire: Wire, ending: Ending, deadline: Duration, fields: Vec<Field>) -> Self {
        wire.adopt(LineHabits {
            ending: match ending {
                Ending::Cr => "\r",
                Ending::Lf => "\n",
                Ending::CrLf => "\r\n",
            },
            deadline,
            pace: Duration::from_millis(20),
            // No query is known that any such instrument answers recognisably: late answers are waited out instead.
            sign: None,
            hint: "Check power, cable, baud rate, the query's text and its line end.",
        });
        Self { wire, fields }
    }

    async fn answer(&mut self, query: &str) -> Result<String, DriverError> {
        let doing = format!("asking {query:?}");
        let mut tries = Tries::default();
        loop {
            match self.wire.ask(query, &doing).await {
                // Asking again does no harm, also on a line that was lost meanwhile.
                Err(failure) => tries.again_if_reopened(failure)?,
                answer => return answer,
            }
        }
    }

    fn take(&mut self, answer: &str, field: &Field) -> Result<MonitorReading, DriverError> {
        let number = field_of(answer, field.field).and_then(number_in);
        number.and_then(|raw| field.value.reading(raw)).map_err(|why| {
            let doing = format!("asking {:?} for {}", field.query, field.value.name);
            self.wire.unexpected(&doing, answer, &format!("field {}: {why}", field.field))
        })
    }
}

/// A field of an answer, counted from 0.
fn field_of(answer: &str, index: usize) -> Result<&str, &'static str> {
    let field = if answer.contains([',', ';']) {
        answer.split([',', ';']).nth(index)
    } else if index == 0 && number_in(answer).is_ok() {
        // One number with its unit, which a blank may part.
        Some(answer)
    } else {
        answer.split_whitespace().nth(index)
    };
    field.map(str::trim).ok_or("the answer has not so many fields")
}

#[async_trait]
impl Monitor for AsciiQuery {
    async fn read(&mut self) -> Result<Vec<MonitorReading>, DriverError> {
        let fields = self.fields.clone();
        let mut readings = Vec::with_capacity(fields.len());
        let mut asked: Vec<(&str, String)> = Vec::new();
        for field in &fields {
            let known = asked.iter().position(|(query, _)| *query == field.query);
            let at = match known {
                Some(at) => at,
                None => {
                    let answer = self.answer(&field.query).await?;
                    asked.push((&field.query, answer));
                    asked.len() - 1
                }
            };
            readings.push(self.take(&asked[at].1, field)?);
        }
        Ok(readings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::LineDecoder;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

    fn field(query: &str, field: usize, name: &str, offset: f64) -> Field {
        let value = Scaled { name: name.to_owned(), scale: 1.0, offset };
        Field { query: query.to_owned(), field, value }
    }

    /// Answers each query by `answers`, and counts them.
    async fn answering(mut far: DuplexStream, answers: fn(&str, u32) -> Option<&'static str>) {
        let mut decoder = LineDecoder::default();
        let mut count = 0;
        while let Ok(byte) = far.read_u8().await {
            let Some(Ok(line)) = decoder.push(byte) else { continue };
            count += 1;
            if let Some(answer) = answers(&line, count) {
                far.write_all(format!("{answer}\r\n").as_bytes()).await.unwrap();
            }
        }
    }

    fn monitor(answers: fn(&str, u32) -> Option<&'static str>, fields: Vec<Field>) -> AsciiQuery {
        let (near, far) = duplex(256);
        tokio::spawn(answering(far, answers));
        AsciiQuery::new(Wire::over(near, "logger"), Ending::CrLf, Duration::from_secs(1), fields)
    }

    #[tokio::test(start_paused = true)]
    async fn fields_are_taken_and_one_query_is_asked_once() {
        let answers = |line: &str, count| match (line, count) {
            ("KRDG? 0", 1) => Some("+296.15,+523.40,T3=80.2"),
            ("P?", 2) => Some("4.01 bar"),
            _ => None,
        };
        let mut bar = field("P?", 0, "chamber_pressure_pa", 0.0);
        bar.value.scale = 1e5;
        let fields = vec![
            field("KRDG? 0", 1, "wall_temperature_k", 0.0),
            field("KRDG? 0", 2, "fuel_temperature_k", 273.15),
            bar,
        ];
        let values: Vec<f64> =
            monitor(answers, fields).read().await.unwrap().iter().map(|r| r.value).collect();
        for (value, expected) in values.iter().zip([523.40, 353.35, 4.01e5]) {
            assert!((value - expected).abs() < 1e-6 * expected, "{values:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_silent_try_is_repeated_and_three_are_an_error() {
        let mut good =
            monitor(|_, count| count.is_multiple_of(3).then_some("7"), vec![field("V?", 0, "x_v", 0.0)]);
        assert!((good.read().await.unwrap()[0].value - 7.0).abs() < 1e-12);
        let mut dead = monitor(|_, _| None, vec![field("V?", 0, "x_v", 0.0)]);
        let error = dead.read().await.unwrap_err();
        assert!(matches!(error, DriverError::Silent { tries: 3, .. }), "{error}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_field_that_is_missing_or_no_number_is_named() {
        for (answer, words) in [
            (Some("1,2"), "not so many fields"),
            (Some("1,2,OVER"), "expected a number"),
            (Some("1,2,9.9E37"), "overload"),
        ] {
            let (near, mut far) = duplex(256);
            tokio::spawn(async move {
                let mut seen = [0; 64];
                while let Ok(1..) = far.read(&mut seen).await {
                    far.write_all(format!("{}\r", answer.unwrap_or_default()).as_bytes()).await.unwrap();
                }
            });
            let wire = Wire::over(near, "logger");
            let fields = vec![field("V?", 2, "x_v", 0.0)];
            let mut monitor = AsciiQuery::new(wire, Ending::Lf, Duration::from_secs(1), fields);
            let error = monitor.read().await.unwrap_err().to_string();
            assert!(error.contains(words) && error.contains("x_v"), "{error}");
        }
    }
}
