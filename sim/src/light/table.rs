//! Tables of numbers with one header line, as text.
//!
//! Reads what is handed in; knows no files.

use std::cmp::Ordering;

/// Why a table could not be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TableError {
    /// There is no header line.
    #[error("the table is empty: a header line with column names is needed")]
    Empty,
    /// A column is not there.
    #[error("the table has no column `{wanted}`; it has {found}")]
    Column {
        /// The column asked for.
        wanted: String,
        /// The columns there are.
        found: String,
    },
    /// A row has another number of fields than the header.
    #[error("row {row} has {found} fields, the header has {wanted}")]
    Width {
        /// Row, 1 for the first below the header.
        row: usize,
        /// Fields in the row.
        found: usize,
        /// Fields in the header.
        wanted: usize,
    },
    /// A field is not a number.
    #[error("row {row}, column `{column}`: `{text}` is not a number")]
    Number {
        /// Row, 1 for the first below the header.
        row: usize,
        /// Name of the column.
        column: String,
        /// What stands there.
        text: String,
    },
    /// A column that must ascend does not, or has fewer than two finite rows.
    #[error("column `{column}` must ascend strictly over at least two rows; row {row} does not")]
    Order {
        /// Row, 1 for the first below the header.
        row: usize,
        /// Name of the column.
        column: String,
    },
}

/// Columns of f64 under names. Blank lines and lines that start with `#` are skipped.
#[derive(Debug, Clone)]
pub struct Table {
    names: Vec<String>,
    columns: Vec<Vec<f64>>,
}

impl Table {
    /// Reads comma-separated text.
    ///
    /// # Errors
    ///
    /// [`TableError`] when it is empty, ragged or holds text where a number should be.
    pub fn parse(text: &str) -> Result<Self, TableError> {
        let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
        let header = lines.next().ok_or(TableError::Empty)?;
        let names: Vec<String> = header.split(',').map(|name| name.trim().to_owned()).collect();
        let mut columns = vec![Vec::new(); names.len()];
        for (index, line) in lines.enumerate() {
            let row = index + 1;
            let fields: Vec<&str> = line.split(',').map(str::trim).collect();
            if fields.len() != names.len() {
                return Err(TableError::Width { row, found: fields.len(), wanted: names.len() });
            }
            for ((column, name), text) in columns.iter_mut().zip(&names).zip(fields) {
                column.push(text.parse().map_err(|_| TableError::Number {
                    row,
                    column: name.clone(),
                    text: text.to_owned(),
                })?);
            }
        }
        Ok(Self { names, columns })
    }

    /// Names of the columns, in the order of the text.
    pub fn names(&self) -> &[String] {
        &self.names
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

    /// One column that ascends strictly.
    ///
    /// # Errors
    ///
    /// As [`Table::column`], or [`TableError::Order`].
    pub fn ascending(&self, name: &str) -> Result<&[f64], TableError> {
        let column = self.column(name)?;
        let order = |row| TableError::Order { row, column: name.to_owned() };
        if column.len() < 2 {
            return Err(order(column.len()));
        }
        match column.windows(2).position(|pair| pair[0].partial_cmp(&pair[1]) != Some(Ordering::Less)) {
            Some(index) => Err(order(index + 2)),
            None => Ok(column),
        }
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
        assert_eq!(wide, TableError::Width { row: 2, found: 1, wanted: 2 });
        let text = Table::parse("a,b\n1,2\n3,x\n").unwrap_err();
        assert_eq!(text.to_string(), "row 2, column `b`: `x` is not a number");
        let table = Table::parse("a,b\n1,2\n1,3\n").unwrap();
        assert_eq!(table.ascending("a").unwrap_err(), TableError::Order { row: 2, column: "a".into() });
        assert!(matches!(table.column("c"), Err(TableError::Column { .. })));
    }

    #[test]
    fn outside_the_nodes_the_ends_are_kept() {
        let (nodes, values) = ([1.0, 2.0, 4.0], [10.0, 20.0, 0.0]);
        for (at, wanted) in [(0.0, 10.0), (1.0, 10.0), (1.5, 15.0), (3.0, 10.0), (4.0, 0.0), (9.0, 0.0)] {
            assert!((interpolate(&nodes, &values, at) - wanted).abs() < 1e-12, "{at}");
        }
    }
}
