//! Turns trouble with a config into a message with file, line, caret, the allowed keys and a guess.

use super::{Problem, SCHEMA};
use std::fmt::Write as _;

/// Why a campaign file cannot be used; the text is ready for a terminal.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ConfigError(pub String);

/// Largest edit similarity below which no guess is offered (Jaro–Winkler, 0 … 1): chosen so that one wrong,
/// missing or doubled letter in a word of four is still recognised.
const GUESS_FROM: f64 = 0.75;

impl ConfigError {
    /// From the TOML reader's error.
    pub(super) fn from_toml(name: &str, text: &str, error: &toml::de::Error) -> Self {
        let message = error.message();
        let (headline, hints) = explain(message);
        let place = error.span().map(|span| Place::of_offset(text, span.start, span.end - span.start));
        Self(render(name, place.as_ref(), &headline, &hints))
    }

    /// From checks of a config whose keys are all known.
    pub(super) fn from_problems(name: &str, text: &str, problems: &[Problem]) -> Self {
        let parts: Vec<String> = problems
            .iter()
            .map(|problem| {
                let place = locate(text, &problem.key);
                render(name, place.as_ref(), &format!("`{}`: {}", problem.key, problem.message), &[])
            })
            .collect();
        Self(parts.join("\n"))
    }
}

/// Refuses a file whose `schema` is newer than ours before its keys are judged.
pub(super) fn refuse_newer_schema(name: &str, text: &str) -> Result<(), ConfigError> {
    let Ok(table) = text.parse::<toml::Table>() else { return Ok(()) };
    match table.get("schema").and_then(toml::Value::as_integer) {
        Some(version) if version > i64::from(SCHEMA) => Err(ConfigError(render(
            name,
            locate(text, "schema").as_ref(),
            &format!("schema {version} is newer than this program, which reads up to schema {SCHEMA}"),
            &["use a newer ditd, or write the file for the older schema".to_owned()],
        ))),
        _ => Ok(()),
    }
}

struct Place {
    line: usize,
    column: usize,
    length: usize,
    text: String,
}

impl Place {
    fn of_offset(text: &str, start: usize, length: usize) -> Self {
        let start = start.min(text.len());
        let before = &text[..start];
        let line = before.matches('\n').count() + 1;
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        let line_text = text[line_start..].lines().next().unwrap_or("").to_owned();
        let column = text[line_start..start].chars().count() + 1;
        let room = line_text.chars().count().saturating_sub(column - 1).max(1);
        Self { line, column, length: length.clamp(1, room), text: line_text }
    }
}

fn render(name: &str, place: Option<&Place>, headline: &str, hints: &[String]) -> String {
    let mut out = String::new();
    match place {
        Some(place) => {
            let number = place.line.to_string();
            let margin = " ".repeat(number.len());
            // Writing to a String cannot fail.
            let _ = writeln!(out, "{name}:{}:{}: {headline}", place.line, place.column);
            let _ = writeln!(out, "{margin} |");
            let _ = writeln!(out, "{number} | {}", place.text);
            let _ = write!(out, "{margin} | {}{}", " ".repeat(place.column - 1), "^".repeat(place.length));
        }
        None => {
            let _ = write!(out, "{name}: {headline}");
        }
    }
    for hint in hints {
        let _ = write!(out, "\n  = {hint}");
    }
    out
}

/// Splits serde's words into a headline and hints.
fn explain(message: &str) -> (String, Vec<String>) {
    let Some((headline, allowed)) = message.split_once(", expected ") else {
        return (message.trim().to_owned(), Vec::new());
    };
    let quoted =
        |text: &str| -> Vec<String> { text.split('`').skip(1).step_by(2).map(str::to_owned).collect() };
    let keys = quoted(allowed);
    let Some(wrong) = quoted(headline).into_iter().next() else {
        return (message.trim().to_owned(), Vec::new());
    };
    if keys.is_empty() {
        return (message.trim().to_owned(), Vec::new());
    }
    let mut hints = vec![format!("allowed here: {}", keys.join(", "))];
    let best = keys
        .iter()
        .map(|key| (strsim::jaro_winkler(key, &wrong), key))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(similarity, _)| *similarity >= GUESS_FROM);
    if let Some((_, key)) = best {
        hints.push(format!("did you mean `{key}`?"));
    }
    (headline.replace("unknown field", "unknown key").trim().to_owned(), hints)
}

/// Finds the line of `table.key` (or a top-level `key`) by reading headers and assignments. A part such as `monitor[1]`
/// means the second table of an array of tables.
fn locate(text: &str, path: &str) -> Option<Place> {
    let (table, key) = path.rsplit_once('.').unwrap_or(("", path));
    let mut current = String::new();
    let mut header = None;
    // How many tables of each array were seen; those within a table begin anew with it.
    let mut seen: Vec<(String, usize)> = Vec::new();
    let mut outermost = None;
    for (index, line) in text.lines().enumerate() {
        let trimmed = line.trim();
        if trimmed.starts_with('[') {
            let name = trimmed.split(']').next().unwrap_or("").trim_matches('[').trim();
            if trimmed.starts_with("[[") {
                seen.retain(|(other, _)| !other.starts_with(&format!("{name}.")));
                match seen.iter_mut().find(|(other, _)| other == name) {
                    Some((_, count)) => *count += 1,
                    None => seen.push((name.to_owned(), 0)),
                }
            }
            current = numbered(name, &seen);
            // A path may name an array's table by its number or, when there is one only, without.
            if current == table || name == table && header.is_none() {
                header = Some((index, line));
                current = table.to_owned();
            } else if table.starts_with(&format!("{current}.")) {
                // Values written inline have no header of their own.
                outermost = Some((index, line));
            }
        } else if current == table {
            let name = trimmed.split('=').next().unwrap_or("").trim();
            if name == key {
                let column = line.chars().take_while(|c| c.is_whitespace()).count() + 1;
                return Some(Place { line: index + 1, column, length: key.len(), text: line.to_owned() });
            }
        }
    }
    header.or(outermost).map(|(index, line)| Place {
        line: index + 1,
        column: 1,
        length: line.len(),
        text: line.to_owned(),
    })
}

/// A header's name with the number of each array of tables in it.
fn numbered(name: &str, seen: &[(String, usize)]) -> String {
    let mut path = String::new();
    let mut out = String::new();
    for part in name.split('.').map(str::trim) {
        if !path.is_empty() {
            path.push('.');
            out.push('.');
        }
        path.push_str(part);
        out.push_str(part);
        if let Some((_, count)) = seen.iter().find(|(other, _)| *other == path) {
            // Writing to a String cannot fail.
            let _ = write!(out, "[{count}]");
        }
    }
    out
}
