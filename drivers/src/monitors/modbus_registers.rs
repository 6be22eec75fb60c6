//! Process values from the registers of a Modbus RTU unit.
//!
//! Which register, type and word order belong to each value. Every value is read by a question of its own: units with
//! holes between their registers refuse longer ones.

use super::Scaled;
use crate::error::DriverError;
use crate::instrument::{Monitor, MonitorReading};
use crate::modbus::{Master, Question};
use crate::wire::{Wire, WireSettings};
use async_trait::async_trait;

/// Common bit rate of such units; the configuration says another.
const BAUD: u32 = 19_200;

/// Registers of the question by which the thread is found again: more than any value has.
const SIGN_COUNT: u16 = 3;

/// How the bits of a value are meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RegisterType {
    /// One register, 0 … 65535.
    U16,
    /// One register, −32768 … 32767.
    I16,
    /// Two registers, unsigned.
    U32,
    /// Two registers, signed.
    I32,
    /// Two registers, IEEE 754 single.
    F32,
}

/// Which of two registers comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WordOrder {
    /// The high word.
    HighFirst,
    /// The low word.
    LowFirst,
}

/// Which table a register belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Table {
    /// Holding registers, function 3.
    Holding,
    /// Input registers, function 4.
    Input,
}

/// One value.
#[derive(Debug, Clone, PartialEq)]
pub struct RegisterValue {
    /// Its table.
    pub table: Table,
    /// Its first register, as it goes over the line (from 0).
    pub register: u16,
    /// How its bits are meant.
    pub kind: RegisterType,
    /// Order of its words.
    pub order: WordOrder,
    /// What becomes of its number.
    pub value: Scaled,
}

impl RegisterType {
    /// How many registers it has.
    pub fn count(self) -> u16 {
        match self {
            Self::U16 | Self::I16 => 1,
            Self::U32 | Self::I32 | Self::F32 => 2,
        }
    }

    /// The number of its registers; `None` when their count does not fit.
    pub fn decode(self, registers: &[u16], order: WordOrder) -> Option<f64> {
        let bits = |a: u16, b: u16| {
            let (high, low) = if order == WordOrder::HighFirst { (a, b) } else { (b, a) };
            u32::from(high) << 16 | u32::from(low)
        };
        Some(match (self, registers) {
            (Self::U16, &[one]) => f64::from(one),
            (Self::I16, &[one]) => f64::from(one.cast_signed()),
            (Self::U32, &[a, b]) => f64::from(bits(a, b)),
            (Self::I32, &[a, b]) => f64::from(bits(a, b).cast_signed()),
            (Self::F32, &[a, b]) => f64::from(f32::from_bits(bits(a, b))),
            _ => return None,
        })
    }
}

impl Table {
    fn question(self, register: u16, count: u16) -> Question {
        match self {
            Self::Holding => Question::Holding { register, count },
            Self::Input => Question::Input { register, count },
        }
    }
}

/// The line settings when nothing is configured.
pub fn wire_settings() -> WireSettings {
    WireSettings { baud: BAUD }
}

/// A unit at the end of a wire.
#[derive(Debug)]
pub struct ModbusRegisters {
    master: Master,
    values: Vec<RegisterValue>,
}

impl ModbusRegisters {
    /// A monitor of `unit` over an open wire. Sends nothing.
    pub fn new(wire: Wire, unit: u8, values: Vec<RegisterValue>) -> Self {
        let baud = wire.baud().unwrap_or(BAUD);
        let sign = values.first().map(|first| first.table.question(first.register, SIGN_COUNT));
        let hint = "Check power, cable, baud rate, parity (none) and the unit's Modbus address.";
        Self { master: Master::new(wire, unit, baud, sign, hint), values }
    }

    async fn read_one(&mut self, value: &RegisterValue) -> Result<MonitorReading, DriverError> {
        let doing = format!("reading {} (register {})", value.value.name, value.register);
        let question = value.table.question(value.register, value.kind.count());
        let registers = match self.master.read(question, &doing).await {
            // Reading again does no harm.
            Err(error) if error.is_reopened() => self.master.read(question, &doing).await?,
            other => other?,
        };
        let number = value.kind.decode(&registers, value.order).ok_or("another number of registers");
        number.and_then(|raw| value.value.reading(raw)).map_err(|why| DriverError::Garbled {
            who: self.master.name().to_owned(),
            doing,
            answer: format!("{registers:04x?}"),
            why: why.to_owned(),
            hint: "Check type and word order of the value, and its sensor.".to_owned(),
        })
    }
}

#[async_trait]
impl Monitor for ModbusRegisters {
    async fn read(&mut self) -> Result<Vec<MonitorReading>, DriverError> {
        let values = self.values.clone();
        let mut readings = Vec::with_capacity(values.len());
        for value in &values {
            readings.push(self.read_one(value).await?);
        }
        Ok(readings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modbus::Answer;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

    fn value(register: u16, kind: RegisterType, order: WordOrder, scale: f64) -> RegisterValue {
        let value = Scaled { name: format!("r{register}_k"), scale, offset: 0.0 };
        RegisterValue { table: Table::Input, register, kind, order, value }
    }

    /// A unit whose registers are those of `memory`; it knows no question that goes beyond them.
    async fn unit(mut far: DuplexStream, memory: Vec<u16>) {
        let mut frame = [0; 8];
        while far.read_exact(&mut frame).await.is_ok() {
            let (unit, question) = Question::decode(&frame).unwrap();
            let answer = match question {
                Question::Input { register, count } => {
                    let range = usize::from(register)..usize::from(register) + usize::from(count);
                    memory.get(range).map_or(Answer::Refused(2), |part| Answer::Registers(part.to_vec()))
                }
                _ => Answer::Refused(1),
            };
            far.write_all(&answer.encode(unit, question)).await.unwrap();
        }
    }

    #[tokio::test(start_paused = true)]
    async fn every_type_and_both_word_orders_are_read() {
        use RegisterType::{F32, I16, I32, U16, U32};
        use WordOrder::{HighFirst, LowFirst};
        // 523.15 as f32 is 0x4402C99A.
        let memory = vec![5231, 0xfff6, 0x4402, 0xc99a, 0xc99a, 0x4402, 0x0001, 0x0002, 0xffff, 0xfffe];
        let (near, far) = duplex(256);
        tokio::spawn(unit(far, memory));
        let values = vec![
            value(0, U16, HighFirst, 0.1),
            value(1, I16, HighFirst, 1.0),
            value(2, F32, HighFirst, 1.0),
            value(4, F32, LowFirst, 1.0),
            value(6, U32, HighFirst, 1.0),
            value(8, I32, HighFirst, 1.0),
        ];
        let mut monitor = ModbusRegisters::new(Wire::over(near, "PLC"), 3, values);
        let got: Vec<f64> = monitor.read().await.unwrap().iter().map(|reading| reading.value).collect();
        for (value, expected) in got.iter().zip([523.1, -10.0, 523.15, 523.15, 65538.0, -2.0]) {
            assert!((value - expected).abs() < 1e-4, "{got:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn no_number_and_no_register_are_told() {
        let (near, far) = duplex(256);
        tokio::spawn(unit(far, vec![0x7fc0, 0, 0]));
        let values = vec![value(0, RegisterType::F32, WordOrder::HighFirst, 1.0)];
        let error = ModbusRegisters::new(Wire::over(near, "PLC"), 3, values).read().await.unwrap_err();
        assert!(error.to_string().contains("not a finite number"), "{error}");
        let (near, far) = duplex(256);
        tokio::spawn(unit(far, vec![0; 3]));
        let values = vec![value(7, RegisterType::U16, WordOrder::HighFirst, 1.0)];
        let error = ModbusRegisters::new(Wire::over(near, "PLC"), 3, values).read().await.unwrap_err();
        assert!(
            error.to_string().contains("r7_k") && error.to_string().contains("no such register"),
            "{error}"
        );
    }
}
