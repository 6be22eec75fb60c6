//! Tables of numbers with one header line, as text, and what the file says of itself.
//!
//! Reads what is handed in; knows no files.

use super::provenance::{Provenance, Status};
use std::cmp::Ordering;

/// Why a table could not be read. Lines are those of the file from 1; rows are 1 for the first below the header.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TableError {
    /// There is no header line.
    #[error("the table is empty: a header line with column names is needed")]
    Empty,
    /// The columns are not separated by commas.
    #[error("line {line}: columns are separated by commas and decimals have a point; semicolons were found")]
    Separator {
        /// Line of the header.
        line: usize,
    },
    /// A column is not there.
    #[error("the table has no column `{wanted}`; it has {found}")]
    Column {
        /// The column asked for.
        wanted: String,
        /// The columns there are.
        found: String,
    },
    /// Two columns have the same name.
    #[error("line {line}: the column `{column}` is there twice")]
    Twice {
        /// Line of the header.
        line: usize,
        /// Name of the column.
        column: String,
    },
    /// A row has another number of fields than the header.
    #[error("row {row} (line {line}) has {found} fields, the header has {wanted}")]
    Width {
        /// Row.
        row: usize,
        /// Line.
        line: usize,
        /// Fields in the row.
        found: usize,
        /// Fields in the header.
        wanted: usize,
    },
    /// A field is not a number.
    #[error("row {row} (line {line}), column `{column}`: `{text}` is not a number")]
    Number {
        /// Row.
        row: usize,
        /// Line.
        line: usize,
        /// Name of the column.
        column: String,
        /// What stands there.
        text: String,
    },
    /// A number is not possible.
    #[error("row {row} (line {line}), column `{column}`: {value} is not possible; it must be {wanted}")]
    Value {
        /// Row.
        row: usize,
        /// Line.
        line: usize,
        /// Name of the column.
        column: String,
        /// What stands there.
        value: f64,
        /// What would be possible.
        wanted: &'static str,
    },
    /// A column that must ascend does not.
    #[error("column `{column}` must ascend strictly; row {row} (line {line}) does not")]
    Order {
        /// Row.
        row: usize,
        /// Line.
        line: usize,
        /// Name of the column.
        column: String,
    },
    /// A column that must ascend has fewer than two rows.
    #[error("column `{column}` needs at least two rows, found {found}")]
    Rows {
        /// Name of the column.
        column: String,
        /// Rows there are.
        found: usize,
    },
    /// The status of the numbers is none that there is.
    #[error("line {line}: status `{word}` is none of {}", Status::WORDS.map(|(_, word)| word).join(", "))]
    Status {
        /// Line.
        line: usize,
        /// What stands there.
        word: String,
    },
}

/// Fields of text under names: what a [`Table`] is made from. Blank lines and lines that start with `#` are
/// skipped; comments above the header are the [`Provenance`].
#[derive(Debug, Clone)]
pub struct Records<'a> {
    names: Vec<&'a str>,
    rows: Vec<(usize, Vec<&'a str>)>,
    provenance: Provenance,
}

impl<'a> Records<'a> {
    /// Splits comma-separated text; fields may stand in double quotes but hold no commas.
    ///
    /// # Errors
    ///
    /// [`TableError`] when it is empty, ragged, names a column twice or has an unknown status.
    pub fn parse(text: &'a str) -> Result<Self, TableError> {
        let fields = |line: &'a str| -> Vec<&'a str> {
            line.split(',').map(|field| field.trim().trim_matches('"').trim()).collect()
        };
        let mut provenance = Provenance::default();
        let mut names: Option<Vec<&str>> = None;
        let mut rows = Vec::new();
        for (line, content) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
            let content = content.trim();
            if let Some(comment) = content.strip_prefix('#') {
                if names.is_none() {
                    provenance.take_in(comment).map_err(|word| TableError::Status { line, word })?;
                }
                continue;
            }
            if content.is_empty() {
                continue;
            }
            let found = fields(content);
            let Some(names) = &names else {
                if found.len() == 1 && content.contains(';') {
                    return Err(TableError::Separator { line });
                }
                if let Some((_, name)) = found.iter().enumerate().find(|(i, name)| found[..*i].contains(name))
                {
                    return Err(TableError::Twice { line, column: (*name).to_owned() });
                }
                names = Some(found);
                continue;
            };
            if found.len() != names.len() {
                let row = rows.len() + 1;
                return Err(TableError::Width { row, line, found: found.len(), wanted: names.len() });
            }
            rows.push((line, found));
        }
        Ok(Self { names: names.ok_or(TableError::Empty)?, rows, provenance })
    }

    /// What the file says of itself.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// One field as text; `index` is 0 for the first row.
    ///
    /// # Errors
    ///
    /// [`TableError::Column`] when there is none of that name.
    pub fn text(&self, index: usize, column: &str) -> Result<&'a str, TableError> {
        Ok(self.rows[index].1[self.position(column)?])
    }

    /// One field as a number.
    ///
    /// # Errors
    ///
    /// [`TableError::Column`] or [`TableError::Number`].
    pub fn number(&self, index: usize, column: &str) -> Result<f64, TableError> {
        self.number_at(index, self.position(column)?)
    }

    fn position(&self, wanted: &str) -> Result<usize, TableError> {
        let found = || self.names.join(", ");
        let none = || TableError::Column { wanted: wanted.to_owned(), found: found() };
        self.names.iter().position(|own| *own == wanted).ok_or_else(none)
    }

    fn number_at(&self, index: usize, column: usize) -> Result<f64, TableError> {
        let (line, fields) = &self.rows[index];
        fields[column].parse().map_err(|_| TableError::Number {
            row: index + 1,
            line: *line,
            column: self.names[column].to_owned(),
            text: fields[column].to_owned(),
        })
    }
}

/// Columns of f64 under names, with their provenance.
#[derive(Debug, Clone)]
pub struct Table {
    names: Vec<String>,
    columns: Vec<Vec<f64>>,
    lines: Vec<usize>,
    provenance: Provenance,
}

impl Table {
    /// Reads comma-separated text as [`Records::parse`] splits it.
    ///
    /// # Errors
    ///
    /// [`TableError`] as there, or when text stands where a number should be.
    pub fn parse(text: &str) -> Result<Self, TableError> {
        let records = Records::parse(text)?;
        let rows = 0..records.len();
        let columns = (0..records.names.len())
            .map(|column| rows.clone().map(|row| records.number_at(row, column)).collect())
            .collect::<Result<_, TableError>>()?;
        Ok(Self {
            names: records.names.iter().map(|name| (*name).to_owned()).collect(),
            columns,
            lines: records.rows.iter().map(|row| row.0).collect(),
            provenance: records.provenance,
        })
    }

    /// Names of the columns, in the order of the text.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// What the file says of itself.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// One column.
    ///
    /// # Errors
    ///
    /// [`TableError::Column`] when there is none of that name.
    pub fn column(&self, name: &str) -> Result<&[f64], TableError> {
        let index = self
            .names
            .iter()
            .position(|own| own == name)
            .ok_or_else(|| TableError::Column { wanted: name.to_owned(), found: self.names.join(", ") })?;
        Ok(&self.columns[index])
    }

    /// One column of possible values; `wanted` says which those are, after "it must be".
    ///
    /// # Errors
    ///
    /// As [`Table::column`], or [`TableError::Value`] with the first row that is not possible.
    pub fn possible(
        &self,
        name: &str,
        wanted: &'static str,
        possible: impl Fn(f64) -> bool,
    ) -> Result<&[f64], TableError> {
        let column = self.column(name)?;
        match column.iter().position(|&value| !possible(value)) {
            Some(index) => Err(TableError::Value {
                row: index + 1,
                line: self.lines[index],
                column: name.to_owned(),
                value: column[index],
                wanted,
            }),
            None => Ok(column),
        }
    }

    /// One column that ascends strictly over at least two rows.
    ///
    /// # Errors
    ///
    /// As [`Table::column`], or [`TableError::Order`], or [`TableError::Rows`].
    pub fn ascending(&self, name: &str) -> Result<&[f64], TableError> {
        let column = self.column(name)?;
        if column.len() < 2 {
            return Err(TableError::Rows { column: name.to_owned(), found: column.len() });
        }
        match column.windows(2).position(|pair| pair[0].partial_cmp(&pair[1]) != Some(Ordering::Less)) {
            Some(index) => Err(TableError::Order {
                row: index + 2,
                line: self.lines[index + 1],
                column: name.to_owned(),
            }),
            None => Ok(column),
        }
    }

    /// Wavelengths in µm: 1e4/wavenumber_cm-1 where there is such a column beside `wavelength_um` (the wavelengths
    /// are rounded then).
    ///
    /// # Errors
    ///
    /// As [`Table::ascending`], or [`TableError::Value`] unless they are finite and above 0.
    pub fn wavelengths_um(&self) -> Result<Vec<f64>, TableError> {
        self.possible("wavelength_um", "finite and above 0", |um| um > 0.0 && um.is_finite())?;
        let rounded = self.ascending("wavelength_um")?;
        Ok(match self.column("wavenumber_cm-1") {
            Ok(wavenumber) if wavenumber.windows(2).all(|pair| pair[0] > pair[1] && pair[1] > 0.0) => {
                wavenumber.iter().map(|nu| 1e4 / nu).collect()
            }
            _ => rounded.to_vec(),
        })
    }

    /// Columns of one quantity at several temperatures: names `PREFIX<T>K`, ascending in T, in K.
    pub fn over_temperature(&self, prefix: &str) -> Vec<(f64, &str)> {
        let kelvin = |name: &str| name.strip_prefix(prefix)?.strip_suffix('K')?.parse::<f64>().ok();
        let mut found: Vec<(f64, &str)> =
            self.names.iter().filter_map(|name| Some((kelvin(name)?, name.as_str()))).collect();
        found.retain(|(kelvin, _)| kelvin.is_finite());
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        found
    }
}

/// Position of `at` on the ascending `nodes`: (index of the lower node, fraction towards the next), clamped to
/// the ends. At least two nodes.
pub fn locate(nodes: &[f64], at: f64) -> (usize, f64) {
    let lower = nodes.partition_point(|&node| node <= at).clamp(1, nodes.len() - 1) - 1;
    let fraction = (at - nodes[lower]) / (nodes[lower + 1] - nodes[lower]);
    (lower, fraction.clamp(0.0, 1.0))
}

/// Linear interpolation of `values` over the ascending `nodes`, clamped to the ends.
pub fn interpolate(nodes: &[f64], values: &[f64], at: f64) -> f64 {
    let (lower, fraction) = locate(nodes, at);
    values[lower] + fraction * (values[lower + 1] - values[lower])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_field_is_named_by_row_and_column() {
        assert_eq!(Table::parse("\n").unwrap_err(), TableError::Empty);
        let wide = Table::parse("a,b\n1,2\n3\n").unwrap_err();
        assert_eq!(wide, TableError::Width { row: 2, line: 3, found: 1, wanted: 2 });
        let text = Table::parse("# a: comment\na,b\n\n1,2\n3,x\n").unwrap_err();
        assert_eq!(text.to_string(), "row 2 (line 5), column `b`: `x` is not a number");
        assert_eq!(Table::parse("a,b,a\n").unwrap_err(), TableError::Twice { line: 1, column: "a".into() });
        assert_eq!(Table::parse("#\na;b\n1,5;2\n").unwrap_err(), TableError::Separator { line: 2 });
        let status = Table::parse("# status: sure\na\n").unwrap_err().to_string();
        assert_eq!(status, "line 1: status `sure` is none of measured, model, assumed");
        let table = Table::parse("a,b\n1,2\n1,3\n").unwrap();
        assert_eq!(
            table.ascending("a").unwrap_err(),
            TableError::Order { row: 2, line: 3, column: "a".into() }
        );
        let value = table.possible("b", "below 3", |b| b < 3.0).unwrap_err().to_string();
        assert_eq!(value, "row 2 (line 3), column `b`: 3 is not possible; it must be below 3");
        assert!(matches!(
            Table::parse("a\n1\n").unwrap().ascending("a"),
            Err(TableError::Rows { found: 1, .. })
        ));
        assert!(matches!(table.column("c"), Err(TableError::Column { .. })));
    }

    #[test]
    fn what_a_file_says_of_itself_is_kept() {
        let text = "\u{feff}# status: model\n# source: me\n\"wavelength_um\",x_300K,x_250.5K,x_K\n1,2,3,4\n# status: x\n";
        let table = Table::parse(text).unwrap();
        assert_eq!(table.provenance().status, Some(Status::Model));
        assert_eq!(table.provenance().source, "me");
        assert_eq!(table.over_temperature("x_"), [(250.5, "x_250.5K"), (300.0, "x_300K")]);
        assert_eq!(table.names()[0], "wavelength_um");
    }

    proptest::proptest! {
        /// Whatever a file holds, reading it ends with a table or a reason, and what is possible is what was asked for.
        #[test]
        fn no_text_is_too_strange(text in "[a-z0-9#:,;.\\-\n \"]{0,80}", header in "(# status: m[a-z]{3,7}\n)?a,b\n") {
            for text in [text.clone(), format!("{header}{text}")] {
                let Ok(table) = Table::parse(&text) else { continue };
                for name in table.names() {
                    let above = table.possible(name, "above 0", |value| value > 0.0);
                    proptest::prop_assert!(above.is_err() || above.is_ok_and(|c| c.iter().all(|v| *v > 0.0)));
                    if let Ok(column) = table.ascending(name) {
                        proptest::prop_assert!(column.windows(2).all(|pair| pair[0] < pair[1]) && column.len() > 1);
                    }
                }
            }
        }
    }

    #[test]
    fn outside_the_nodes_the_ends_are_kept() {
        let (nodes, values) = ([1.0, 2.0, 4.0], [10.0, 20.0, 0.0]);
        for (at, wanted) in [(0.0, 10.0), (1.0, 10.0), (1.5, 15.0), (3.0, 10.0), (4.0, 0.0), (9.0, 0.0)] {
            assert!((interpolate(&nodes, &values, at) - wanted).abs() < 1e-12, "{at}");
        }
    }
}
