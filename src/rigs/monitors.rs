//! Opens the monitors of process values.

use super::{OpenError, Prepared, line_settings, no_world, simulate_sensors};
use crate::campaign::{MonitorLine, Monitors, Watched};
use crate::config::{self, monitor};
use ditd_drivers::instrument::Monitor;
use ditd_drivers::monitors::{Absent, Scaled, ascii_query, csv_tail, modbus_registers};
use ditd_drivers::wire::{Reopening, Wire};
use ditd_sim::rig::line;
use ditd_sim::rig::process::{SensorMonitor, Sensors};
use std::time::Duration;

/// Longest wait for the answer of a monitor, in s, unless the campaign file says another.
const ANSWER_S: f64 = 1.0;

/// A file without a new line for so long is stale, in s; the campaign file has to say it, so that this is never used.
const STALE_S: f64 = 60.0;

impl Prepared {
    /// Opens the sources of process values. One that is not required and cannot be opened is told once and left out.
    pub(super) async fn open_monitors(&self, start: tokio::time::Instant) -> Result<Monitors, OpenError> {
        let mut lines = Vec::with_capacity(self.config.monitors.len());
        for monitor in &self.config.monitors {
            let source: Box<dyn Monitor> = match self.open_monitor(monitor, start).await {
                Ok(source) => source,
                Err(OpenError::Driver(error)) if !monitor.required => Box::new(Absent(error)),
                Err(error) => return Err(error),
            };
            let values = monitor.values.iter();
            let values = values.map(|v| Watched { name: v.name.clone(), low: v.low, high: v.high }).collect();
            lines.push(MonitorLine {
                name: monitor.name.clone(),
                required: monitor.required,
                values,
                source,
            });
        }
        Ok(Monitors::new(lines))
    }

    async fn open_monitor(
        &self,
        monitor: &config::Monitor,
        start: tokio::time::Instant,
    ) -> Result<Box<dyn Monitor>, OpenError> {
        let role = format!("monitor {}", monitor.name);
        let policy = Reopening::for_s(monitor.reopen_s);
        match monitor.driver.as_str() {
            "ascii_query" => {
                let fields = monitor.values.iter().map(ascii_field).collect();
                let ending = match monitor.ending.as_deref() {
                    Some("\r") => ascii_query::Ending::Cr,
                    Some("\n") => ascii_query::Ending::Lf,
                    _ => ascii_query::Ending::CrLf,
                };
                let deadline = Duration::from_secs_f64(monitor.timeout_s.unwrap_or(ANSWER_S));
                let wire = if monitor.address == "sim" {
                    let rig = self.config.rig.as_ref().ok_or_else(no_world)?;
                    let (own, seed) = (rig.clone(), self.config.campaign.seed);
                    let faults = rig.process.as_ref().map(|process| process.line_faults.clone());
                    let name = format!("{role} at sim");
                    let opener =
                        line::opener(name.clone(), faults.unwrap_or_default(), start, move |stream| {
                            drop(simulate_sensors(&own, stream, seed, start));
                        });
                    Wire::plugged(opener, name).await?
                } else {
                    let settings = line_settings(monitor.baud, ascii_query::wire_settings());
                    Wire::open(&monitor.address, &role, &settings).await?
                };
                Ok(Box::new(ascii_query::AsciiQuery::new(wire.reopening(policy), ending, deadline, fields)))
            }
            "modbus_registers" => {
                let values = monitor.values.iter().map(register_value).collect();
                let settings = line_settings(monitor.baud, modbus_registers::wire_settings());
                let wire = Wire::open(&monitor.address, &role, &settings).await?.reopening(policy);
                let unit = monitor.unit.unwrap_or(1);
                Ok(Box::new(modbus_registers::ModbusRegisters::new(wire, unit, values)))
            }
            "csv_tail" => {
                let path = monitor.address.strip_prefix("file:").unwrap_or(&monitor.address);
                let columns = monitor.values.iter().map(|value| csv_tail::Column {
                    column: value.column.clone().unwrap_or_default(),
                    value: scaled(value),
                });
                let stale = Duration::from_secs_f64(monitor.stale_s.unwrap_or(STALE_S));
                let separator = monitor.separator.unwrap_or(',');
                Ok(Box::new(csv_tail::CsvTail::new(path.into(), separator, stale, columns.collect())))
            }
            "sim" => {
                let rig = self.config.rig.as_ref().ok_or_else(no_world)?;
                let sensors = Sensors::new(rig, self.config.campaign.seed, start);
                let names = monitor.values.iter().map(|value| value.name.clone()).collect();
                Ok(Box::new(SensorMonitor::new(sensors, names)))
            }
            other => Err(OpenError::Config(format!("monitor.driver: there is no driver {other:?}"))),
        }
    }
}

fn scaled(value: &config::MonitorValue) -> Scaled {
    Scaled { name: value.name.clone(), scale: value.scale, offset: value.offset }
}

fn ascii_field(value: &config::MonitorValue) -> ascii_query::Field {
    ascii_query::Field {
        query: value.query.clone().unwrap_or_default(),
        field: value.field.unwrap_or(0),
        value: scaled(value),
    }
}

fn register_value(value: &config::MonitorValue) -> modbus_registers::RegisterValue {
    use modbus_registers::{RegisterType, Table, WordOrder};
    modbus_registers::RegisterValue {
        table: if value.function == Some(4) { Table::Input } else { Table::Holding },
        register: value.register.unwrap_or(0),
        kind: match value.kind {
            Some(monitor::Kind::I16) => RegisterType::I16,
            Some(monitor::Kind::U32) => RegisterType::U32,
            Some(monitor::Kind::I32) => RegisterType::I32,
            Some(monitor::Kind::F32) => RegisterType::F32,
            Some(monitor::Kind::U16) | None => RegisterType::U16,
        },
        order: match value.word_order {
            Some(monitor::WordOrder::LowFirst) => WordOrder::LowFirst,
            Some(monitor::WordOrder::HighFirst) | None => WordOrder::HighFirst,
        },
        value: scaled(value),
    }
}
