//! What goes wrong between a camera and its client, on command of a test.
//!
//! Chances are drawn from counters, never from a generator with a state: the same seed and the same frames give the
//! same losses, however the client behaves. Knows no socket: it only says what is to happen to a packet.

use crate::rig::line::check_seconds;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;

/// A fault. Frames are counted from 0 over the life of the camera, whether they were sent or not; answers from 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum GigeFault {
    /// Each packet is lost with this probability, a resent one again.
    PacketLoss {
        /// From 0 to 1.
        probability: f64,
    },
    /// Each frame is lost whole with this probability: its id is missing.
    FrameLoss {
        /// From 0 to 1.
        probability: f64,
    },
    /// Frame `frame` is lost whole.
    LoseFrame {
        /// Which.
        frame: u64,
    },
    /// Frame `frame` comes without its leader, which cannot be had again by chance either: resends of it are lost.
    LoseLeader {
        /// Which.
        frame: u64,
    },
    /// The same for the trailer.
    LoseTrailer {
        /// Which.
        frame: u64,
    },
    /// Each packet changes places with the next one with this probability.
    Reordered {
        /// From 0 to 1.
        probability: f64,
    },
    /// Each packet comes twice with this probability.
    Duplicated {
        /// From 0 to 1.
        probability: f64,
    },
    /// Each payload packet is cut to half its length with this probability.
    Truncated {
        /// From 0 to 1.
        probability: f64,
    },
    /// Each packet comes late with this probability.
    LatePackets {
        /// From 0 to 1.
        probability: f64,
        /// By how many seconds, 60 at most.
        delay_s: f64,
    },
    /// Resend requests are answered with PACKET_UNAVAILABLE.
    ResendRefused,
    /// Resend requests are not answered at all.
    ResendIgnored,
    /// At frame `frame` the block id jumps ahead by `by`, and no frame was lost.
    IdJump {
        /// Which.
        frame: u64,
        /// By how much.
        by: u64,
    },
    /// The first block id of every stream.
    IdStart {
        /// 1 or more; with standard ids at most 65535.
        id: u64,
    },
    /// From frame `frame` on the clock of the stream is off by `step_ns`.
    TimestampStep {
        /// Since which.
        frame: u64,
        /// In nanoseconds.
        step_ns: i64,
    },
    /// From frame `frame` on nothing is streamed for `duration_s`; the frames of that time are lost.
    Stall {
        /// Since which.
        frame: u64,
        /// Seconds.
        duration_s: f64,
    },
    /// Before frame `frame` the camera restarts, once: registers to their defaults, control lost, no answer for `silent_s`.
    Restart {
        /// Which.
        frame: u64,
        /// Seconds.
        silent_s: f64,
    },
    /// Commands do not count as heartbeats from `after_s` seconds of control on: control is lost one timeout later.
    HeartbeatIgnored {
        /// Seconds.
        after_s: f64,
    },
    /// Control is refused, as if another application had it.
    AccessDenied,
    /// Leaders name another pixel format than the register.
    WrongPixelFormat {
        /// PFNC code, for instance 0x01080001 (Mono8).
        code: u32,
    },
    /// Every `every`-th acknowledge is lost.
    AnswerLost {
        /// Which.
        every: u64,
    },
    /// Every `every`-th acknowledge comes late.
    AnswerLate {
        /// Which.
        every: u64,
        /// By how many seconds, 60 at most.
        delay_s: f64,
    },
}

impl GigeFault {
    /// Whether the fault can be played.
    ///
    /// # Errors
    /// Names the key whose value is impossible.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::PacketLoss { probability }
            | Self::FrameLoss { probability }
            | Self::Reordered { probability }
            | Self::Duplicated { probability }
            | Self::Truncated { probability } => check_probability(*probability),
            Self::LatePackets { probability, delay_s } => {
                check_probability(*probability).and_then(|()| check_delay(*delay_s))
            }
            Self::IdStart { id: 0 } => Err("id = 0: block ids begin with 1".to_owned()),
            Self::Stall { duration_s, .. } => check_seconds("duration_s", *duration_s),
            Self::Restart { silent_s, .. } => check_seconds("silent_s", *silent_s),
            Self::HeartbeatIgnored { after_s } => check_seconds("after_s", *after_s),
            Self::AnswerLost { every } => check_every(*every),
            Self::AnswerLate { every, delay_s } => check_every(*every).and_then(|()| check_delay(*delay_s)),
            Self::LoseFrame { .. }
            | Self::LoseLeader { .. }
            | Self::LoseTrailer { .. }
            | Self::ResendRefused
            | Self::ResendIgnored
            | Self::IdJump { .. }
            | Self::IdStart { .. }
            | Self::TimestampStep { .. }
            | Self::AccessDenied
            | Self::WrongPixelFormat { .. } => Ok(()),
        }
    }
}

fn check_probability(probability: f64) -> Result<(), String> {
    if (0.0..=1.0).contains(&probability) {
        Ok(())
    } else {
        Err(format!("probability = {probability}: expected 0 to 1"))
    }
}

fn check_every(every: u64) -> Result<(), String> {
    if every > 0 { Ok(()) } else { Err("every = 0: answers are counted from 1".to_owned()) }
}

fn check_delay(delay_s: f64) -> Result<(), String> {
    if (0.0..=60.0).contains(&delay_s) {
        Ok(())
    } else {
        Err(format!("delay_s = {delay_s}: expected seconds from 0 to 60"))
    }
}

/// What happens to a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct PacketFate {
    /// It does not come.
    pub(super) lost: bool,
    /// It comes behind the next one.
    pub(super) swapped: bool,
    /// It comes twice.
    pub(super) doubled: bool,
    /// It is cut to half its length.
    pub(super) cut: bool,
    /// It comes so much later.
    pub(super) late: Option<Duration>,
}

/// Which packet is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PacketKey {
    /// Ordinal of its frame.
    pub(super) frame: u64,
    /// Its number in the block.
    pub(super) packet: u32,
    /// Number of packets of the block.
    pub(super) packets: u32,
    /// How often the frame's packets were asked for again; 0 when first sent.
    pub(super) attempt: u32,
}

/// What a draw is for: keeps faults of one packet independent of each other.
#[derive(Debug, Clone, Copy)]
enum Draw {
    Packet = 1,
    Frame = 2,
    Swap = 3,
    Double = 4,
    Cut = 5,
    Late = 6,
}

/// The faults that a camera plays; others can be put in their place while it runs.
#[derive(Debug)]
pub(super) struct Faults {
    list: RwLock<Arc<[GigeFault]>>,
    seed: u64,
}

impl Faults {
    /// Faults that have been checked.
    pub(super) fn new(list: Vec<GigeFault>, seed: u64) -> Self {
        Self { list: RwLock::new(list.into()), seed }
    }

    /// Plays these from now on, and no longer the earlier ones.
    pub(super) fn replace(&self, list: Vec<GigeFault>) {
        *self.list.write().unwrap_or_else(PoisonError::into_inner) = list.into();
    }

    fn list(&self) -> Arc<[GigeFault]> {
        Arc::clone(&self.list.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// What happens to a packet.
    pub(super) fn packet(&self, key: PacketKey) -> PacketFate {
        let mut fate = PacketFate::default();
        let hits = |probability: f64, draw: Draw| probability > self.uniform(key, draw);
        let is_payload = key.packet > 0 && key.packet + 1 < key.packets;
        for fault in self.list().iter() {
            match fault {
                GigeFault::PacketLoss { probability } => fate.lost |= hits(*probability, Draw::Packet),
                GigeFault::LoseLeader { frame } => fate.lost |= key.frame == *frame && key.packet == 0,
                GigeFault::LoseTrailer { frame } => {
                    fate.lost |= key.frame == *frame && key.packet + 1 == key.packets;
                }
                GigeFault::Reordered { probability } => fate.swapped |= hits(*probability, Draw::Swap),
                GigeFault::Duplicated { probability } => fate.doubled |= hits(*probability, Draw::Double),
                GigeFault::Truncated { probability } => {
                    fate.cut |= is_payload && hits(*probability, Draw::Cut);
                }
                GigeFault::LatePackets { probability, delay_s } if hits(*probability, Draw::Late) => {
                    fate.late = Some(Duration::from_secs_f64(*delay_s));
                }
                _ => {}
            }
        }
        fate
    }

    /// Whether a frame is lost whole.
    pub(super) fn loses_frame(&self, frame: u64) -> bool {
        let key = PacketKey { frame, packet: 0, packets: 0, attempt: 0 };
        self.list().iter().any(|fault| match fault {
            GigeFault::FrameLoss { probability } => *probability > self.uniform(key, Draw::Frame),
            GigeFault::LoseFrame { frame: which } => *which == frame,
            _ => false,
        })
    }

    /// By how much the block id jumps at a frame.
    pub(super) fn id_jump(&self, frame: u64) -> u64 {
        self.list()
            .iter()
            .map(|fault| match fault {
                GigeFault::IdJump { frame: at, by } if *at == frame => *by,
                _ => 0,
            })
            .fold(0, u64::saturating_add)
    }

    /// The first block id of a stream.
    pub(super) fn first_id(&self) -> u64 {
        self.find(|fault| if let GigeFault::IdStart { id } = fault { Some(*id) } else { None }).unwrap_or(1)
    }

    /// By how much the stream's clock is off at a frame, in nanoseconds.
    pub(super) fn clock_error_ns(&self, frame: u64) -> i64 {
        self.list()
            .iter()
            .map(|fault| match fault {
                GigeFault::TimestampStep { frame: from, step_ns } if frame >= *from => *step_ns,
                _ => 0,
            })
            .fold(0, i64::saturating_add)
    }

    /// How long the stream stalls when it comes to a frame.
    pub(super) fn stall(&self, frame: u64) -> Option<Duration> {
        self.find(|fault| match fault {
            GigeFault::Stall { frame: at, duration_s } if *at == frame => {
                Some(Duration::from_secs_f64(*duration_s))
            }
            _ => None,
        })
    }

    /// How long the camera is silent if it restarts before a frame.
    pub(super) fn restart(&self, frame: u64) -> Option<Duration> {
        self.find(|fault| match fault {
            GigeFault::Restart { frame: at, silent_s } if *at == frame => {
                Some(Duration::from_secs_f64(*silent_s))
            }
            _ => None,
        })
    }

    /// After how much control commands no longer count as heartbeats.
    pub(super) fn heartbeat_ignored(&self) -> Option<Duration> {
        self.find(|fault| match fault {
            GigeFault::HeartbeatIgnored { after_s } => Some(Duration::from_secs_f64(*after_s)),
            _ => None,
        })
    }

    /// The pixel format that leaders name instead of the register's.
    pub(super) fn pixel_format(&self) -> Option<u32> {
        self.find(|fault| if let GigeFault::WrongPixelFormat { code } = fault { Some(*code) } else { None })
    }

    /// Whether a fault without keys is played.
    pub(super) fn has(&self, fault: &GigeFault) -> bool {
        self.list().contains(fault)
    }

    /// What happens to the `ordinal`-th acknowledge: `None`: lost; else how late it is.
    pub(super) fn answer(&self, ordinal: u64) -> Option<Duration> {
        let mut late = Duration::ZERO;
        for fault in self.list().iter() {
            match fault {
                GigeFault::AnswerLost { every } if ordinal.is_multiple_of(*every) => return None,
                GigeFault::AnswerLate { every, delay_s } if ordinal.is_multiple_of(*every) => {
                    late += Duration::from_secs_f64(*delay_s);
                }
                _ => {}
            }
        }
        Some(late)
    }

    fn find<T>(&self, pick: impl Fn(&GigeFault) -> Option<T>) -> Option<T> {
        self.list().iter().find_map(pick)
    }

    /// A number from 0 to below 1 for this packet and purpose.
    fn uniform(&self, key: PacketKey, draw: Draw) -> f64 {
        let packet = u64::from(key.packet) << 32 | u64::from(key.attempt);
        let bits = [key.frame, packet, draw as u64]
            .into_iter()
            .fold(self.seed, |state, word| mix(state ^ mix(word)));
        // 53 bits: every value is exact.
        (bits >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood 2014) with its increment.
fn mix(word: u64) -> u64 {
    let word = word.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let word = (word ^ word >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let word = (word ^ word >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    word ^ word >> 31
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(frame: u64, packet: u32, attempt: u32) -> PacketKey {
        PacketKey { frame, packet, packets: 450, attempt }
    }

    fn losses(seed: u64, attempt: u32) -> Vec<bool> {
        let faults = Faults::new(vec![GigeFault::PacketLoss { probability: 0.1 }], seed);
        (0..40_000).map(|i| faults.packet(key(i / 400, (i % 400) as u32, attempt)).lost).collect()
    }

    /// Binomial: 40000 draws of 0.1 have a standard deviation of 60; neighbours are independent.
    #[test]
    fn losses_have_their_probability_and_repeat_with_the_seed() {
        let lost = losses(5, 0);
        let count = lost.iter().filter(|&&lost| lost).count();
        assert!((count as f64 - 4000.0).abs() < 300.0, "{count}");
        let pairs = lost.windows(2).filter(|pair| pair[0] && pair[1]).count();
        // 400 expected, standard deviation 20.
        assert!((pairs as f64 - 400.0).abs() < 110.0, "{pairs}");
        assert_eq!(lost, losses(5, 0));
        for other in [losses(6, 0), losses(5, 1)] {
            let both = lost.iter().zip(&other).filter(|(a, b)| **a && **b).count();
            assert!((both as f64 - 400.0).abs() < 110.0, "{both}");
        }
    }

    #[test]
    fn certain_faults_always_strike_and_impossible_ones_never() {
        let sure = Faults::new(
            vec![
                GigeFault::Truncated { probability: 1.0 },
                GigeFault::Duplicated { probability: 1.0 },
                GigeFault::Reordered { probability: 0.0 },
                GigeFault::LatePackets { probability: 1.0, delay_s: 0.5 },
            ],
            1,
        );
        let middle = sure.packet(key(0, 7, 0));
        assert!(middle.cut && middle.doubled && !middle.swapped && !middle.lost);
        assert_eq!(middle.late, Some(Duration::from_millis(500)));
        assert!(!sure.packet(key(0, 0, 0)).cut && !sure.packet(key(0, 449, 0)).cut);
    }

    #[test]
    fn faults_strike_where_they_are_told_to() {
        let faults = Faults::new(
            vec![
                GigeFault::LoseLeader { frame: 3 },
                GigeFault::LoseTrailer { frame: 4 },
                GigeFault::LoseFrame { frame: 5 },
                GigeFault::IdJump { frame: 6, by: 10 },
                GigeFault::TimestampStep { frame: 7, step_ns: -5 },
                GigeFault::Stall { frame: 8, duration_s: 2.0 },
                GigeFault::IdStart { id: 65530 },
                GigeFault::AnswerLost { every: 3 },
                GigeFault::AnswerLate { every: 2, delay_s: 1.0 },
            ],
            1,
        );
        assert!(faults.packet(key(3, 0, 2)).lost && !faults.packet(key(3, 1, 0)).lost);
        assert!(faults.packet(key(4, 449, 0)).lost && !faults.packet(key(4, 0, 0)).lost);
        assert!(faults.loses_frame(5) && !faults.loses_frame(4));
        assert_eq!((faults.id_jump(6), faults.id_jump(7)), (10, 0));
        assert_eq!((faults.clock_error_ns(6), faults.clock_error_ns(9)), (0, -5));
        assert_eq!((faults.stall(8), faults.stall(9)), (Some(Duration::from_secs(2)), None));
        assert_eq!(faults.first_id(), 65530);
        assert_eq!(faults.answer(3), None);
        assert_eq!(faults.answer(2), Some(Duration::from_secs(1)));
        assert_eq!(faults.answer(1), Some(Duration::ZERO));
    }

    #[test]
    fn faults_are_read_from_a_file_and_impossible_ones_named() {
        #[derive(Deserialize)]
        struct File {
            fault: Vec<GigeFault>,
        }
        let text = "[[fault]]\nkind = \"packet-loss\"\nprobability = 0.01\n[[fault]]\nkind = \"resend-refused\"\n\
                    [[fault]]\nkind = \"restart\"\nframe = 100\nsilent_s = 6.0\n";
        let file: File = toml::from_str(text).unwrap();
        assert_eq!(file.fault[0], GigeFault::PacketLoss { probability: 0.01 });
        assert_eq!(file.fault[1], GigeFault::ResendRefused);
        assert_eq!(file.fault[2], GigeFault::Restart { frame: 100, silent_s: 6.0 });
        assert!(toml::from_str::<File>("[[fault]]\nkind = \"stall\"\nframe = 1\nseconds = 1\n").is_err());
        for (fault, name) in [
            (GigeFault::PacketLoss { probability: 1.5 }, "probability"),
            (GigeFault::Reordered { probability: f64::NAN }, "probability"),
            (GigeFault::LatePackets { probability: 0.5, delay_s: -1.0 }, "delay_s"),
            (GigeFault::IdStart { id: 0 }, "id"),
            (GigeFault::Stall { frame: 0, duration_s: f64::INFINITY }, "duration_s"),
            (GigeFault::Restart { frame: 0, silent_s: -1.0 }, "silent_s"),
            (GigeFault::AnswerLost { every: 0 }, "every"),
            (GigeFault::AnswerLate { every: 1, delay_s: 61.0 }, "delay_s"),
        ] {
            assert!(fault.check().unwrap_err().starts_with(name), "{fault:?}");
        }
        assert_eq!(GigeFault::IdStart { id: 65535 }.check(), Ok(()));
    }
}
