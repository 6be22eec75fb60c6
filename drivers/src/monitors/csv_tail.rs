//! Process values from the last line of a CSV file that another program writes.
//!
//! The first line names the columns. A line counts when it has ended; a file that has not grown for the time given is
//! stale. Reads the beginning and the end of the file only, as it stands at each reading.

use super::{Scaled, number_in};
use crate::error::DriverError;
use crate::instrument::{Monitor, MonitorReading};
use async_trait::async_trait;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;
use std::time::Duration;
use tokio::time::Instant;

/// Longest line, in bytes: what a logger of some hundred channels writes, tenfold.
const LINE_BYTES_MAX: u64 = 65_536;

/// One value.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// The column's name in the first line.
    pub column: String,
    /// What becomes of its number.
    pub value: Scaled,
}

/// A file that grows.
#[derive(Debug)]
pub struct CsvTail {
    path: PathBuf,
    separator: char,
    stale_after: Duration,
    columns: Vec<Column>,
    last: Option<Seen>,
}

/// What was seen last, and when it was new.
#[derive(Debug)]
struct Seen {
    length: u64,
    line: String,
    at: Instant,
}

impl CsvTail {
    /// A monitor of the file at `path`, whose fields are parted by `separator`. Reads nothing.
    pub fn new(path: PathBuf, separator: char, stale_after: Duration, columns: Vec<Column>) -> Self {
        Self { path, separator, stale_after, columns, last: None }
    }

    fn who(&self) -> String {
        format!("monitor at file:{}", self.path.display())
    }

    /// The first line, the last whole line, and the file's length.
    fn look(&self) -> std::io::Result<(String, Option<String>, u64)> {
        // A pipe would be waited for, and a device has no end.
        if !std::fs::metadata(&self.path)?.is_file() {
            return Err(std::io::Error::other("it is no file"));
        }
        let mut file = File::open(&self.path)?;
        let length = file.metadata()?.len();
        let mut beginning = Vec::new();
        (&mut file).take(LINE_BYTES_MAX).read_to_end(&mut beginning)?;
        let beginning = String::from_utf8_lossy(&beginning).into_owned();
        let header_length = beginning.find('\n').map_or(length, |at| at as u64 + 1);
        let header = beginning.lines().next().unwrap_or_default().trim_start_matches('\u{feff}').to_owned();
        let from = length.saturating_sub(LINE_BYTES_MAX).max(header_length);
        file.seek(SeekFrom::Start(from))?;
        let mut end = Vec::new();
        file.take(LINE_BYTES_MAX).read_to_end(&mut end)?;
        // Bytes after the last line end belong to a line that is still being written.
        let whole = end.iter().rposition(|byte| *byte == b'\n').map_or(0, |at| at + 1);
        let text = String::from_utf8_lossy(&end[..whole]).into_owned();
        let last = text.lines().rev().map(str::trim).find(|line| !line.is_empty()).map(str::to_owned);
        Ok((header, last, length))
    }

    fn fields<'a>(&self, line: &'a str) -> Vec<&'a str> {
        line.trim().split(self.separator).map(|field| field.trim().trim_matches('"').trim()).collect()
    }

    fn garbled(&self, doing: &str, answer: &str, why: String) -> DriverError {
        DriverError::Garbled {
            who: self.who(),
            doing: doing.to_owned(),
            answer: answer.to_owned(),
            why,
            hint: "Check the column's name, the separator and the program that writes the file.".to_owned(),
        }
    }

    fn take(&self, header: &str, line: &str) -> Result<Vec<MonitorReading>, DriverError> {
        let (names, fields) = (self.fields(header), self.fields(line));
        if names.len() != fields.len() {
            let why = format!("{} fields where the first line has {}", fields.len(), names.len());
            return Err(self.garbled("reading the last line", line, why));
        }
        self.columns
            .iter()
            .map(|column| {
                let doing = format!("reading {}", column.value.name);
                let at = names.iter().position(|name| *name == column.column).ok_or_else(|| {
                    self.garbled(&doing, header, format!("there is no column {:?}", column.column))
                })?;
                number_in(fields[at])
                    .and_then(|raw| column.value.reading(raw))
                    .map_err(|why| self.garbled(&doing, line, format!("column {:?}: {why}", column.column)))
            })
            .collect()
    }
}

#[async_trait]
impl Monitor for CsvTail {
    async fn read(&mut self) -> Result<Vec<MonitorReading>, DriverError> {
        let (header, line, length) = self.look().map_err(|error| DriverError::Missing {
            who: self.who(),
            why: error.to_string(),
            hint: "Check the path, and that the program which writes the file runs.".to_owned(),
        })?;
        let now = Instant::now();
        let who = self.who();
        let stale = |since: Instant| {
            DriverError::Silent {
            who: who.clone(),
            doing: "waiting for a new line".to_owned(),
            waited: now - since,
            tries: 1,
            hint: "Check that the program which writes the file still runs, and compare stale_s with its period."
                .to_owned(),
        }
        };
        let Some(line) = line else {
            // An empty file may get its first line soon.
            let since = self.last.get_or_insert(Seen { length, line: String::new(), at: now }).at;
            return Err(stale(since));
        };
        let since = match &self.last {
            Some(seen) if seen.length == length && seen.line == line => seen.at,
            _ => now,
        };
        let age = now - since;
        if age > self.stale_after {
            return Err(stale(since));
        }
        let readings = self.take(&header, &line)?;
        self.last = Some(Seen { length, line, at: since });
        Ok(readings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use tokio::time::sleep;

    /// A file of this test's own, removed at its end.
    struct Own(PathBuf);

    impl Own {
        fn new(name: &str, text: &str) -> Self {
            let path = std::env::temp_dir().join(format!("ditd-csv-{}-{name}", std::process::id()));
            std::fs::write(&path, text).unwrap();
            Self(path)
        }

        fn add(&self, text: &str) {
            File::options().append(true).open(&self.0).unwrap().write_all(text.as_bytes()).unwrap();
        }

        fn monitor(&self, column: &str) -> CsvTail {
            let value = Scaled { name: "wall_temperature_k".to_owned(), scale: 1.0, offset: 273.15 };
            let columns = vec![Column { column: column.to_owned(), value }];
            CsvTail::new(self.0.clone(), ',', Duration::from_secs(10), columns)
        }
    }

    impl Drop for Own {
        fn drop(&mut self) {
            std::fs::remove_file(&self.0).ok();
        }
    }

    async fn value(monitor: &mut CsvTail) -> f64 {
        monitor.read().await.unwrap()[0].value
    }

    #[tokio::test(start_paused = true)]
    async fn the_last_whole_line_counts() {
        let file = Own::new("last", "time, \"wall\",gas\n1,100.0,200\n2,101.0,200\n3,10");
        let mut monitor = file.monitor("wall");
        assert!((value(&mut monitor).await - 374.15).abs() < 1e-9);
        file.add("2.5,200\r\n\n");
        assert!((value(&mut monitor).await - 375.65).abs() < 1e-9);
        // Written anew, as a logger does at midnight.
        std::fs::write(&file.0, "time,gas,wall\n0,1,50\n").unwrap();
        assert!((value(&mut monitor).await - 323.15).abs() < 1e-9);
    }

    #[tokio::test(start_paused = true)]
    async fn a_file_that_does_not_grow_is_stale_and_a_long_one_is_read_at_its_end() {
        let rows: String = (0..20_000).map(|n| format!("{n},100.0,200\n")).collect();
        let file = Own::new("stale", &format!("time,wall,gas\n{rows}"));
        let mut monitor = file.monitor("wall");
        value(&mut monitor).await;
        sleep(Duration::from_secs(9)).await;
        value(&mut monitor).await;
        sleep(Duration::from_secs(2)).await;
        let error = monitor.read().await.unwrap_err();
        assert!(matches!(error, DriverError::Silent { .. }), "{error}");
        assert!(error.to_string().contains("no answer in 11 s"), "{error}");
        // The same line again is a new line.
        file.add("19999,100.0,200\n");
        value(&mut monitor).await;
    }

    #[tokio::test(start_paused = true)]
    async fn missing_files_columns_and_numbers_are_named() {
        let gone = CsvTail::new(PathBuf::from("/no/such/file.csv"), ',', Duration::from_secs(1), vec![]);
        let mut gone = gone;
        assert!(matches!(gone.read().await, Err(DriverError::Missing { .. })));
        let device = CsvTail::new(PathBuf::from("/dev/zero"), ',', Duration::from_secs(1), vec![]);
        let mut device = device;
        assert!(device.read().await.unwrap_err().to_string().contains("no file"));
        let file = Own::new("bad", "time,wall\n");
        assert!(matches!(file.monitor("wall").read().await, Err(DriverError::Silent { .. })));
        file.add("1,OVER\n");
        for (column, words) in [("wall", "expected a number"), ("wal", "no column \"wal\"")] {
            let error = file.monitor(column).read().await.unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
        file.add("1,2,3\n");
        let error = file.monitor("wall").read().await.unwrap_err().to_string();
        assert!(error.contains("3 fields where the first line has 2"), "{error}");
    }
}
