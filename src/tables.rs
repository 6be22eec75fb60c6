//! Tables as the commands read and print them: comma-separated text in, the same rows with more columns out.
//!
//! Fields that are not asked for are carried through as they are. Rows are counted from 1, the header not included.

use crate::commands::{CommandError, CommandResult};
use std::io::{ErrorKind, Read, Write};
use std::path::Path;

/// Text fields under names.
#[derive(Debug, Clone, PartialEq)]
pub struct TextTable {
    /// Where it came from, for messages.
    origin: String,
    names: Vec<String>,
    rows: Vec<Vec<String>>,
    /// Line of each row in its file, from 1.
    lines: Vec<usize>,
}

impl TextTable {
    /// Reads a file, or standard input when the path is `-`.
    ///
    /// # Errors
    ///
    /// Status 2 when it cannot be read or is no table.
    pub fn read(path: &Path) -> Result<Self, CommandError> {
        let mut text = String::new();
        let origin = if path.as_os_str() == "-" {
            std::io::stdin()
                .lock()
                .read_to_string(&mut text)
                .map_err(|error| CommandError::usage(format!("reading standard input: {error}")))?;
            "standard input".to_owned()
        } else {
            text = std::fs::read_to_string(path)
                .map_err(|error| CommandError::usage(format!("reading {}: {error}", path.display())))?;
            path.display().to_string()
        };
        Self::parse(&origin, &text)
    }

    /// Reads text: one header line, then rows of as many fields. Blank lines are skipped; fields may be in quotes.
    ///
    /// # Errors
    ///
    /// Status 2, naming the row, when it is empty or ragged or names a column twice.
    pub fn parse(origin: &str, text: &str) -> Result<Self, CommandError> {
        let numbered = text.trim_start_matches('\u{feff}').lines().zip(1..);
        let mut lines = numbered.filter(|(line, _)| !line.trim().is_empty());
        let (header, _) = lines
            .next()
            .ok_or_else(|| CommandError::usage(format!("{origin} is empty: a header line is needed")))?;
        let names = fields(header);
        if let Some(twice) = names.iter().enumerate().find(|(i, name)| names[..*i].contains(name)) {
            return Err(CommandError::usage(format!("{origin} has the column `{}` twice", twice.1)));
        }
        let (mut rows, mut at) = (Vec::new(), Vec::new());
        for (line, number) in lines {
            let row = fields(line);
            if row.len() != names.len() {
                return Err(CommandError::usage(format!(
                    "{origin}, row {}: {} fields where the header has {}",
                    rows.len() + 1,
                    row.len(),
                    names.len()
                )));
            }
            rows.push(row);
            at.push(number);
        }
        Ok(Self { origin: origin.to_owned(), names, rows, lines: at })
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Whether there is a column of this name.
    pub fn has(&self, name: &str) -> bool {
        self.names.iter().any(|own| own == name)
    }

    /// One column as numbers.
    ///
    /// # Errors
    ///
    /// Status 2 when there is no such column (naming those there are), or a field in it is no number (naming the row).
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>, CommandError> {
        let column = self.names.iter().position(|own| own == name).ok_or_else(|| {
            CommandError::usage(format!(
                "{} has no column `{name}`; it has {}",
                self.origin,
                self.names.join(", ")
            ))
        })?;
        self.rows
            .iter()
            .enumerate()
            .map(|(row, fields)| {
                let text = fields[column].trim();
                text.parse()
                    .map_err(|_| self.bad_row(row, format!("column `{name}`: `{text}` is not a number")))
            })
            .collect()
    }

    /// One column as texts; None if there is no such column.
    pub fn texts(&self, name: &str) -> Option<Vec<&str>> {
        let column = self.names.iter().position(|own| own == name)?;
        Some(self.rows.iter().map(|fields| fields[column].trim()).collect())
    }

    /// Line of a row in its file, from 1, the header included.
    pub fn line(&self, index: usize) -> usize {
        self.lines[index]
    }

    /// Status 2 about the row of this index (0 for the first).
    pub fn bad_row(&self, index: usize, what: impl std::fmt::Display) -> CommandError {
        CommandError::usage(format!("{}, row {}: {what}", self.origin, index + 1))
    }

    /// Sets a column, at the end when it is new. Numbers are written with 17 significant digits.
    pub fn set(&mut self, name: &str, values: &[f64]) {
        assert!(values.len() == self.rows.len(), "one value per row");
        let column = self.names.iter().position(|own| own == name).unwrap_or_else(|| {
            self.names.push(name.to_owned());
            for row in &mut self.rows {
                row.push(String::new());
            }
            self.names.len() - 1
        });
        for (row, value) in self.rows.iter_mut().zip(values) {
            row[column] = format!("{value:.16e}");
        }
    }

    /// The table as comma-separated text.
    pub fn to_csv(&self) -> String {
        let mut text = String::new();
        for row in std::iter::once(&self.names).chain(&self.rows) {
            let quoted: Vec<String> = row.iter().map(|field| quote(field)).collect();
            text.push_str(&quoted.join(","));
            text.push('\n');
        }
        text
    }

    /// The table as a JSON list of objects; numbers as numbers, those that JSON cannot hold (inf, NaN) as null.
    pub fn to_json(&self) -> String {
        let rows: Vec<serde_json::Value> = self
            .rows
            .iter()
            .map(|row| {
                let members = self.names.iter().zip(row).map(|(name, text)| (name.clone(), json(text)));
                serde_json::Value::Object(members.collect())
            })
            .collect();
        format!("{}\n", serde_json::Value::Array(rows))
    }

    /// Prints the table on standard output. A reader that has gone away is no failure.
    ///
    /// # Errors
    ///
    /// Status 1 when standard output cannot be written.
    pub fn print(&self, as_json: bool) -> CommandResult {
        let text = if as_json { self.to_json() } else { self.to_csv() };
        let mut out = std::io::stdout().lock();
        match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => {
                Err(CommandError::failure(format!("writing the table: {error}")))
            }
            _ => Ok(()),
        }
    }
}

fn json(text: &str) -> serde_json::Value {
    match text.trim().parse::<f64>() {
        Ok(number) => serde_json::Number::from_f64(number).map_or(serde_json::Value::Null, Into::into),
        Err(_) => text.into(),
    }
}

/// Fields of one line: separated by commas, in double quotes where they hold commas themselves.
fn fields(line: &str) -> Vec<String> {
    let mut fields = vec![String::new()];
    let mut quoted = false;
    let mut signs = line.trim_end_matches('\r').chars().peekable();
    while let Some(sign) = signs.next() {
        let at_start = fields.last().is_some_and(String::is_empty);
        match sign {
            '"' if quoted && signs.peek() == Some(&'"') => {
                signs.next();
                push(&mut fields, '"');
            }
            '"' if quoted => quoted = false,
            '"' if at_start => quoted = true,
            ',' if !quoted => fields.push(String::new()),
            other => push(&mut fields, other),
        }
    }
    fields.into_iter().map(|field| field.trim().to_owned()).collect()
}

fn push(fields: &mut [String], sign: char) {
    if let Some(field) = fields.last_mut() {
        field.push(sign);
    }
}

fn quote(field: &str) -> String {
    if field.contains([',', '"']) { format!("\"{}\"", field.replace('"', "\"\"")) } else { field.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_that_nobody_asked_for_come_through_unchanged() {
        let mut table = TextTable::parse("t", "id,x,note\na,1.50,\"p, \"\"q\"\"\"\r\n\nb,2,\n").unwrap();
        assert_eq!(table.numbers("x").unwrap(), [1.5, 2.0]);
        table.set("y", &[0.1, f64::INFINITY]);
        let wanted = "id,x,note,y\na,1.50,\"p, \"\"q\"\"\",1.0000000000000001e-1\nb,2,,inf\n";
        assert_eq!(table.to_csv(), wanted);
        assert_eq!(table.to_json().matches("null").count(), 1);
        table.set("x", &[3.0, 4.0]);
        assert_eq!(table.numbers("x").unwrap(), [3.0, 4.0]);
        assert_eq!((table.line(0), table.line(1)), (2, 4));
        assert_eq!(TextTable::parse("t", &table.to_csv()).unwrap().to_csv(), table.to_csv());
    }

    #[test]
    fn bad_rows_are_named() {
        let message = |text: &str| TextTable::parse("t", text).unwrap_err().message;
        assert_eq!(message("a,b\n1,2\n3\n"), "t, row 2: 1 fields where the header has 2");
        assert!(message("").contains("empty"));
        assert!(message("a,a\n").contains("twice"));
        let table = TextTable::parse("t", "a,b\n1,2\n3,x\n").unwrap();
        assert_eq!(table.numbers("b").unwrap_err().message, "t, row 2: column `b`: `x` is not a number");
        assert_eq!(table.numbers("c").unwrap_err().message, "t has no column `c`; it has a, b");
        assert_eq!(table.numbers("c").unwrap_err().code, 2);
    }
}
