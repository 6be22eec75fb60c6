//! Reads the arrays of NumPy's `.npy` format that scenes need: f32 or f64, little endian, C or Fortran order.
//!
//! Format: numpy.lib.format, versions 1 to 3.

/// An array in C order (last index fastest).
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Length of every axis.
    pub shape: Vec<usize>,
    /// The values, as f64.
    pub values: Vec<f64>,
}

/// Reads the bytes of a `.npy` file.
///
/// # Errors
///
/// A sentence on what is wrong: not the format, another element type, or a wrong length.
pub fn parse(bytes: &[u8]) -> Result<Array, String> {
    let magic = bytes.get(..8).filter(|b| b.starts_with(b"\x93NUMPY")).ok_or("not a .npy file")?;
    let (start, length) = if magic[6] == 1 {
        (10, bytes.get(8..10).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]]))))
    } else {
        (12, bytes.get(8..12).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize))
    };
    let length = length.ok_or("its header is cut off")?;
    let header = bytes.get(start..start + length).ok_or("its header is cut off")?;
    let header = std::str::from_utf8(header).map_err(|_| "its header is not text".to_owned())?;
    let after = |key: &str| header.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
    let descr =
        after("descr").and_then(|r| r.split('\'').nth(1)).ok_or("its header names no element type")?;
    let fortran = after("fortran_order").is_some_and(|r| r.starts_with("True"));
    let shape = after("shape")
        .and_then(|r| r.strip_prefix('('))
        .and_then(|r| r.split_once(')'))
        .map(|(inside, _)| inside)
        .ok_or("its header names no shape")?;
    let shape: Vec<usize> = shape
        .split(',')
        .map(str::trim)
        .filter(|s| !s.is_empty())
        .map(|s| s.parse().map_err(|_| format!("its shape has the entry {s}")))
        .collect::<Result<_, _>>()?;
    let count = shape.iter().try_fold(1_usize, |a, &b| a.checked_mul(b)).ok_or("its shape is too large")?;
    let body = &bytes[start + length..];
    let width = match descr {
        "<f8" => 8,
        "<f4" => 4,
        other => {
            return Err(format!("its elements are {other}; store it as float32 or float64 (little endian)"));
        }
    };
    if count.checked_mul(width) != Some(body.len()) {
        return Err(format!("it holds {} bytes of values, its shape asks for {count} × {width}", body.len()));
    }
    let values: Vec<f64> = if width == 8 {
        body.chunks_exact(8)
            .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
            .collect()
    } else {
        body.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect()
    };
    let values = if fortran { to_c_order(&shape, &values) } else { values };
    Ok(Array { shape, values })
}

fn to_c_order(shape: &[usize], values: &[f64]) -> Vec<f64> {
    let mut place = vec![0_usize; shape.len()];
    let mut out = Vec::with_capacity(values.len());
    for _ in 0..values.len() {
        let offset = place.iter().zip(shape).rev().fold(0, |sum, (&p, &n)| sum * n + p);
        out.push(values[offset]);
        for axis in (0..shape.len()).rev() {
            place[axis] += 1;
            if place[axis] < shape[axis] {
                break;
            }
            place[axis] = 0;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(descr: &str, fortran: &str, shape: &str, body: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend(u16::try_from(header.len()).unwrap().to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(body);
        bytes
    }

    #[test]
    fn both_orders_and_widths_give_the_same_array() {
        let c: Vec<u8> = [1.0_f64, 2.0, 3.0, 4.0, 5.0, 6.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let f: Vec<u8> = [1.0_f32, 4.0, 2.0, 5.0, 3.0, 6.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let a = parse(&file("<f8", "False", "(2, 3)", &c)).unwrap();
        let b = parse(&file("<f4", "True", "(2, 3)", &f)).unwrap();
        assert_eq!(a, b);
        assert_eq!(a.shape, [2, 3]);
    }

    #[test]
    fn wrong_files_are_named() {
        assert!(parse(b"hello").is_err());
        assert!(parse(&file("<i4", "False", "(1,)", &[0; 4])).unwrap_err().contains("float64"));
        assert!(parse(&file("<f8", "False", "(2,)", &[0; 8])).unwrap_err().contains("bytes"));
    }
}
