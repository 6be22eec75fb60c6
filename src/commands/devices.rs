//! `ditd devices`: what is connected to this machine. Opens no port and takes control of no camera.

use super::{CommandError, CommandResult, print};
use ditd_drivers::gige::discovery::{self, Found};
use ditd_drivers::ports::{self, Port};
use serde::Serialize;
use std::net::{IpAddr, Ipv4Addr};
use std::time::Duration;

/// How long cameras may take to answer: GigE Vision gives a device 1 s.
const ANSWER_TIME: Duration = Duration::from_secs(1);

/// List serial ports and GigE Vision cameras
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Ask this address besides: a camera behind a router, or a simulated one on a loopback address
    #[arg(long = "ask", value_name = "ADDRESS")]
    asks: Vec<Ipv4Addr>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Devices {
    serial_ports: Vec<Port>,
    cameras: Vec<Found>,
    /// Networks that were asked for cameras: local address and broadcast address.
    networks: Vec<(Ipv4Addr, Ipv4Addr)>,
    /// What could not be looked at, and why.
    trouble: Vec<String>,
}

/// Runs the command.
///
/// # Errors
///
/// Status 1 when nothing can be printed.
pub fn run(args: Args) -> CommandResult {
    let mut trouble = Vec::new();
    let serial_ports = ports::serial_ports().unwrap_or_else(|why| {
        trouble.push(format!("serial ports: {why}"));
        Vec::new()
    });
    let networks = networks().unwrap_or_else(|why| {
        trouble.push(format!("networks: {why}"));
        Vec::new()
    });
    let mut targets = networks.clone();
    targets.extend(args.asks.iter().map(|address| (Ipv4Addr::UNSPECIFIED, *address)));
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| CommandError::failure(format!("starting the runtime: {error}")))?;
    let cameras = runtime.block_on(discovery::discover(&targets, ANSWER_TIME)).unwrap_or_else(|error| {
        trouble.push(format!("cameras: {error}"));
        Vec::new()
    });
    let devices = Devices { serial_ports, cameras, networks, trouble };
    if args.json {
        let text = serde_json::to_string_pretty(&devices)
            .map_err(|error| CommandError::failure(error.to_string()))?;
        return print(&format!("{text}\n"));
    }
    print(&words(&devices))
}

/// Own address and broadcast address of every network that is up, loopback aside.
fn networks() -> Result<Vec<(Ipv4Addr, Ipv4Addr)>, String> {
    let interfaces = if_addrs::get_if_addrs().map_err(|error| error.to_string())?;
    Ok(interfaces
        .iter()
        .filter(|interface| !interface.is_loopback())
        .filter_map(|interface| match (&interface.addr, interface.ip()) {
            (if_addrs::IfAddr::V4(v4), IpAddr::V4(own)) => Some((own, v4.broadcast?)),
            _ => None,
        })
        .collect())
}

fn words(devices: &Devices) -> String {
    let mut out = String::new();
    out.push_str("serial ports\n");
    if devices.serial_ports.is_empty() {
        out.push_str("  none found; plug the adapter in, or see `ditd doctor`\n");
    }
    for port in &devices.serial_ports {
        let name = port.stable_path.as_ref().unwrap_or(&port.path);
        let parts = [&port.maker, &port.product, &port.serial, &port.usb_id];
        let parts: Vec<&str> = parts.iter().filter_map(|part| part.as_deref()).collect();
        let what = if parts.is_empty() { port.bus.to_owned() } else { parts.join(", ") };
        out.push_str(&format!("  serial:{name}  ({}; {what})\n", port.path));
    }
    out.push_str("GigE Vision cameras\n");
    if devices.cameras.is_empty() {
        let asked: Vec<String> = devices.networks.iter().map(|(own, _)| own.to_string()).collect();
        let asked = if asked.is_empty() { "no network is up".to_owned() } else { asked.join(", ") };
        out.push_str(&format!(
            "  none answered (asked from: {asked}); `--ask ADDRESS` asks a camera in another network\n"
        ));
    }
    for camera in &devices.cameras {
        let name = if camera.user_name.is_empty() { "" } else { ", " };
        out.push_str(&format!(
            "  {}  {} {}, serial {}, version {}{name}{} ({})\n",
            camera.address,
            camera.maker,
            camera.model,
            camera.serial,
            camera.version,
            camera.user_name,
            camera.mac
        ));
    }
    for trouble in &devices.trouble {
        out.push_str(&format!("could not look: {trouble}\n"));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_machine_is_told_what_to_try() {
        let nothing = Devices {
            serial_ports: vec![],
            cameras: vec![],
            networks: vec![],
            trouble: vec!["serial ports: no /sys".to_owned()],
        };
        let words = words(&nothing);
        for part in ["none found", "no network is up", "could not look: serial ports: no /sys"] {
            assert!(words.contains(part), "{words}");
        }
    }
}
