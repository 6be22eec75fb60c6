//! What is wrong with this machine for a campaign, and the command that mends each finding.
//!
//! Reads what the system tells about itself; opens no port and no camera, and changes nothing. The only thing it writes is
//! the file by which it measures the disk, which it removes.

use crate::clock::Clock;
use crate::config::{Config, SIMULATED};
use crate::plan::Plan;
use rustix::fs::Access;
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Bytes of the file by which the disk is measured: more than its own cache of some tens of megabytes.
const DISK_BYTES: usize = 128 << 20;

/// Frame that is assumed without a campaign file: 640 × 512 pixels of two bytes, 100 a second.
const USUAL_FRAME_BYTES: f64 = 640.0 * 512.0 * 2.0;
const USUAL_FRAMES_PER_S: f64 = 100.0;

/// Programs that open a new serial adapter by themselves and write to it, and how to keep them off.
const GRABBERS: [(&str, &str); 2] =
    [("ModemManager", "sudo systemctl disable --now ModemManager"), ("brltty", "sudo apt-get remove brltty")];

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// As it should be.
    Good,
    /// Works, but not at its best, or cannot be told.
    Warning,
    /// A campaign would fail.
    Bad,
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What was looked at.
    pub subject: String,
    /// How bad it is.
    pub state: State,
    /// What was found, with numbers.
    pub found: String,
    /// The command, or the act, that mends it; empty when there is nothing to mend.
    pub mend: String,
}

fn finding(subject: &str, state: State, found: impl Into<String>, mend: impl Into<String>) -> Finding {
    Finding { subject: subject.to_owned(), state, found: found.into(), mend: mend.into() }
}

/// The machine as its file system shows it; `root` is `/` but in tests.
#[derive(Debug, Clone)]
pub struct Machine {
    root: PathBuf,
}

impl Machine {
    /// A machine whose `/proc`, `/sys`, `/dev`, `/run` lie below `root`.
    pub fn at(root: &Path) -> Self {
        Self { root: root.to_owned() }
    }

    fn text(&self, path: &str) -> Option<String> {
        std::fs::read_to_string(self.root.join(path)).ok().map(|text| text.trim().to_owned())
    }

    fn names(&self, folder: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.root.join(folder)).into_iter().flatten();
        let mut names: Vec<String> =
            entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok()).collect();
        names.sort();
        names
    }

    /// Serial ports that this user may not open.
    pub fn serial_rights(&self, wanted: &[String]) -> Vec<Finding> {
        let mut paths: Vec<String> = self
            .names("dev")
            .into_iter()
            .filter(|name| name.starts_with("ttyUSB") || name.starts_with("ttyACM"))
            .map(|name| format!("/dev/{name}"))
            .collect();
        paths.extend(wanted.iter().cloned());
        paths.dedup();
        if paths.is_empty() {
            let found = "no USB serial adapter is plugged in";
            return vec![finding("serial ports", State::Good, found, "")];
        }
        paths.iter().map(|path| self.serial_right(path)).collect()
    }

    fn serial_right(&self, path: &str) -> Finding {
        let subject = format!("serial port {path}");
        let real = self.root.join(path.trim_start_matches('/'));
        if !real.exists() {
            let mend = "plug the adapter in; `ditd devices` lists the ports; write its /dev/serial/by-id/… name into the campaign file";
            return finding(&subject, State::Bad, "there is no such device", mend);
        }
        if rustix::fs::access(&real, Access::READ_OK | Access::WRITE_OK).is_ok() {
            let stable = path.contains("/by-id/") || !path.starts_with("/dev/ttyUSB");
            if stable {
                return finding(&subject, State::Good, "may be opened", "");
            }
            let found = "may be opened, but the number changes when adapters are plugged in another order";
            return finding(
                &subject,
                State::Warning,
                found,
                "ls -l /dev/serial/by-id/ and configure that name",
            );
        }
        finding(
            &subject,
            State::Bad,
            "this user may not read and write it",
            "sudo usermod -aG dialout $USER, then log out and in again",
        )
    }

    /// Programs that write to serial adapters by themselves.
    pub fn grabbers(&self) -> Vec<Finding> {
        let running: Vec<String> = self
            .names("proc")
            .into_iter()
            .filter(|name| name.bytes().all(|byte| byte.is_ascii_digit()))
            .filter_map(|pid| self.text(&format!("proc/{pid}/comm")))
            .collect();
        GRABBERS
            .iter()
            .filter(|(name, _)| running.iter().any(|comm| comm == name))
            .map(|(name, mend)| {
                let found = format!("{name} runs: it opens every new serial adapter and writes to it");
                finding("serial ports", State::Warning, found, *mend)
            })
            .collect()
    }

    /// Room that the system gives to a stream that is not read at once.
    pub fn socket_buffer(&self, wanted: u32) -> Finding {
        const SUBJECT: &str = "socket buffer";
        let mend = format!(
            "sudo sysctl -w net.core.rmem_max={wanted} && echo net.core.rmem_max={wanted} | sudo tee /etc/sysctl.d/60-ditd.conf"
        );
        match self.text("proc/sys/net/core/rmem_max").and_then(|text| text.parse::<u64>().ok()) {
            Some(most) if most >= u64::from(wanted) => finding(
                SUBJECT,
                State::Good,
                format!("net.core.rmem_max = {most} bytes, {wanted} wanted"),
                "",
            ),
            Some(most) => {
                let found = format!(
                    "net.core.rmem_max = {most} bytes, {wanted} wanted: an ordinary user loses frames of a GigE camera"
                );
                finding(SUBJECT, State::Bad, found, mend)
            }
            None => finding(SUBJECT, State::Warning, "net.core.rmem_max cannot be read here", mend),
        }
    }

    /// Whether the fast way past the network stack is open.
    pub fn packet_socket(&self) -> Finding {
        const SUBJECT: &str = "packet socket";
        // capability.h: CAP_NET_RAW is bit 13.
        let may = self
            .text("proc/self/status")
            .and_then(|status| {
                let line = status.lines().find_map(|line| line.strip_prefix("CapEff:"))?.trim().to_owned();
                u64::from_str_radix(&line, 16).ok()
            })
            .is_some_and(|rights| rights >> 13 & 1 == 1);
        if may {
            return finding(SUBJECT, State::Good, "this program may use one", "");
        }
        finding(
            SUBJECT,
            State::Warning,
            "this program may not use one; an ordinary socket with a large buffer does, at a higher load",
            "sudo setcap cap_net_raw+ep $(command -v ditd)",
        )
    }

    /// Largest packets of every network.
    pub fn packet_sizes(&self) -> Vec<Finding> {
        self.names("sys/class/net")
            .into_iter()
            .filter(|name| {
                name != "lo" && self.text(&format!("sys/class/net/{name}/device/uevent")).is_some()
            })
            .filter_map(|name| {
                let mtu: u32 = self.text(&format!("sys/class/net/{name}/mtu"))?.parse().ok()?;
                let subject = format!("packet size on {name}");
                let speed = self
                    .text(&format!("sys/class/net/{name}/speed"))
                    .and_then(|text| text.parse::<i64>().ok())
                    .filter(|speed| *speed > 0)
                    .map(|speed| format!(", {speed} Mbit/s"))
                    .unwrap_or_default();
                Some(if mtu >= 8000 {
                    finding(&subject, State::Good, format!("{mtu} bytes{speed}"), "")
                } else {
                    finding(
                        &subject,
                        State::Warning,
                        format!("{mtu} bytes{speed}: six times as many packets as with jumbo frames"),
                        format!("sudo ip link set dev {name} mtu 9000 (where camera and switch take it)"),
                    )
                })
            })
            .collect()
    }

    /// Whether the time of day is kept right by somebody.
    pub fn clock(&self) -> Finding {
        const SUBJECT: &str = "clock";
        let keepers = ["run/systemd/timesync/synchronized", "run/chrony/chronyd.pid", "run/ntpd.pid"];
        if keepers.iter().any(|path| self.root.join(path).exists()) {
            return finding(SUBJECT, State::Good, "the time of day is synchronised", "");
        }
        finding(
            SUBJECT,
            State::Warning,
            "nothing shows that the time of day is synchronised: the stamps of a run may be wrong by minutes",
            "sudo timedatectl set-ntp true",
        )
    }
}

/// Speed and room of the disk on which runs are written. `needed_bytes` and `needed_per_s` are what a run takes.
pub fn disk(folder: &Path, clock: &Clock, needed_bytes: u64, needed_per_s: f64) -> Vec<Finding> {
    let shown = folder.display();
    let mut findings = Vec::new();
    let subject = format!("disk room in {shown}");
    match rustix::fs::statvfs(folder) {
        Ok(disk) => {
            let free = disk.f_bavail.saturating_mul(disk.f_frsize);
            let state = if free > needed_bytes.saturating_mul(2) {
                State::Good
            } else if free > needed_bytes {
                State::Warning
            } else {
                State::Bad
            };
            let found = format!("{:.1} GB free, {:.1} GB wanted", giga(free), giga(needed_bytes));
            let mend =
                if state == State::Good { "" } else { "free some room, or give --out on another disk" };
            findings.push(finding(&subject, state, found, mend));
        }
        Err(error) => findings.push(finding(
            &subject,
            State::Bad,
            format!("cannot be looked at: {error}"),
            "choose a folder that exists",
        )),
    }
    let subject = format!("disk speed in {shown}");
    findings.push(match measure(folder, clock) {
        Ok(per_s) => {
            let found = format!("{:.0} MB/s to the disk, {:.1} MB/s wanted", per_s / 1e6, needed_per_s / 1e6);
            if per_s > 2.0 * needed_per_s {
                finding(&subject, State::Good, found, "")
            } else {
                let state = if per_s > needed_per_s { State::Warning } else { State::Bad };
                finding(
                    &subject,
                    state,
                    found,
                    "write to a local solid-state disk (--out), not to a network folder",
                )
            }
        }
        Err(error) => finding(
            &subject,
            State::Bad,
            format!("writing fails: {error}"),
            format!("make {shown} writable for this user, or give another folder"),
        ),
    });
    findings
}

fn giga(bytes: u64) -> f64 {
    bytes as f64 / 1e9
}

/// Bytes per second that really reach the disk.
fn measure(folder: &Path, clock: &Clock) -> std::io::Result<f64> {
    let path = folder.join(format!(".ditd-doctor-{}", std::process::id()));
    let chunk = vec![0x5a_u8; 1 << 20];
    let begun = clock.elapsed();
    let written = (|| {
        let mut file = std::fs::File::create(&path)?;
        for _ in 0..DISK_BYTES / chunk.len() {
            file.write_all(&chunk)?;
        }
        file.sync_data()
    })();
    let seconds = (clock.elapsed() - begun).as_secs_f64();
    std::fs::remove_file(&path).or_else(|error| if written.is_ok() { Err(error) } else { Ok(()) })?;
    written.map(|()| DISK_BYTES as f64 / seconds.max(1e-9))
}

/// Looks at everything; with a campaign file also at what that campaign needs.
pub fn examine(machine: &Machine, config: Option<&Config>, folder: &Path, clock: &Clock) -> Vec<Finding> {
    let wanted: Vec<String> = config.map_or(Vec::new(), |config| {
        [&config.plate.address, &config.trigger.address]
            .iter()
            .filter_map(|address| address.strip_prefix("serial:").map(str::to_owned))
            .collect()
    });
    let mut findings = machine.serial_rights(&wanted);
    findings.extend(machine.grabbers());
    let gige = config.and_then(|config| config.camera.gige.clone()).unwrap_or_default();
    findings.extend(camera_library(config));
    findings.push(machine.socket_buffer(gige.socket_buffer_bytes));
    if gige.packet_socket {
        findings.push(machine.packet_socket());
    }
    findings.extend(machine.packet_sizes());
    let (bytes, per_s) = match config {
        Some(config) => {
            let frame = (config.camera.rows * config.camera.columns * 2) as f64;
            (Plan::of_map(config).cost(config).bytes, frame / config.campaign.frame_period_s)
        }
        None => (1 << 30, USUAL_FRAME_BYTES * USUAL_FRAMES_PER_S),
    };
    findings.extend(disk(folder, clock, bytes, per_s));
    findings.push(machine.clock());
    findings
}

fn camera_library(config: Option<&Config>) -> Option<Finding> {
    const SUBJECT: &str = "GigE cameras";
    if cfg!(feature = "aravis") {
        return Some(finding(SUBJECT, State::Good, "built in", ""));
    }
    let needed = config.is_some_and(|config| config.camera.address != SIMULATED);
    let state = if needed { State::Bad } else { State::Warning };
    Some(finding(
        SUBJECT,
        state,
        "this ditd was built without them",
        "sudo apt-get install libaravis-dev libusb-1.0-0-dev && cargo build --release --features aravis",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine(files: &[(&str, &str)]) -> (tempfile::TempDir, Machine) {
        let folder = tempfile::tempdir().unwrap();
        for (path, text) in files {
            let path = folder.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        let machine = Machine::at(folder.path());
        (folder, machine)
    }

    #[test]
    fn a_small_socket_buffer_is_bad_and_the_command_mends_it() {
        let (_folder, small) = machine(&[("proc/sys/net/core/rmem_max", "212992\n")]);
        let found = small.socket_buffer(4 << 20);
        assert_eq!(found.state, State::Bad);
        assert!(found.mend.contains("sysctl -w net.core.rmem_max=4194304"), "{}", found.mend);
        let (_folder, large) = machine(&[("proc/sys/net/core/rmem_max", "4194304\n")]);
        assert_eq!(large.socket_buffer(4 << 20).state, State::Good);
        let (_folder, none) = machine(&[]);
        assert_eq!(none.socket_buffer(4 << 20).state, State::Warning);
    }

    #[test]
    fn rights_are_read_from_the_process() {
        let (_folder, root) = machine(&[("proc/self/status", "Name:\tditd\nCapEff:\t000001ffffffffff\n")]);
        assert_eq!(root.packet_socket().state, State::Good);
        let (_folder, user) = machine(&[("proc/self/status", "CapEff:\t0000000000000000\n")]);
        assert!(user.packet_socket().mend.contains("cap_net_raw"));
    }

    #[test]
    fn small_packets_of_real_networks_are_told() {
        let (_folder, machine) = machine(&[
            ("sys/class/net/lo/mtu", "65536"),
            ("sys/class/net/eth0/mtu", "1500"),
            ("sys/class/net/eth0/device/uevent", ""),
            ("sys/class/net/eth0/speed", "1000"),
            ("sys/class/net/eth1/mtu", "9000"),
            ("sys/class/net/eth1/device/uevent", ""),
            ("sys/class/net/docker0/mtu", "1500"),
        ]);
        let found = machine.packet_sizes();
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].state, found[1].state), (State::Warning, State::Good));
        assert!(found[0].mend.contains("dev eth0 mtu 9000") && found[0].found.contains("1000 Mbit/s"));
    }

    #[test]
    fn a_missing_port_and_a_moving_name_are_told() {
        let (_folder, machine) = machine(&[("dev/ttyUSB0", "")]);
        let found = machine.serial_rights(&["/dev/serial/by-id/usb-FTDI".to_owned()]);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].state, found[1].state), (State::Warning, State::Bad));
        assert!(found[0].mend.contains("by-id"));
    }

    #[test]
    fn a_program_that_writes_to_adapters_is_told() {
        let (_folder, machine) = machine(&[("proc/77/comm", "ModemManager\n"), ("proc/1/comm", "systemd\n")]);
        let found = machine.grabbers();
        assert_eq!(found.len(), 1);
        assert!(found[0].mend.contains("systemctl"));
    }

    #[test]
    fn the_disk_is_measured_and_nothing_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let found = disk(folder.path(), &Clock::start(), 1, 1.0);
        assert!(found.iter().all(|finding| finding.state == State::Good), "{found:?}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let nowhere = disk(Path::new("/no/such/folder"), &Clock::start(), 1, 1.0);
        assert!(nowhere.iter().all(|finding| finding.state == State::Bad && !finding.mend.is_empty()));
    }
}
