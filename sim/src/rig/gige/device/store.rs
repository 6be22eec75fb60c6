//! Where values lie: features in their memory, behind selectors, and registers of the bootstrap.

use super::Device;
use crate::rig::gige::feature::{FEATURES_BASE, double, word};

impl Device {
    /// Address of a feature's register, which a client reads from the description.
    #[cfg(test)]
    pub(in crate::rig::gige) fn address_of(&self, name: &str) -> Option<u32> {
        self.find(name).map(|index| self.features[index].address)
    }

    pub(in crate::rig::gige) fn find(&self, name: &str) -> Option<usize> {
        self.features.iter().position(|feature| feature.name == name)
    }

    pub(in crate::rig::gige) fn index(&self, name: &str) -> usize {
        self.find(name).unwrap_or_else(|| panic!("the table of every make has {name}"))
    }

    pub(in crate::rig::gige) fn integer(&self, name: &str) -> u32 {
        word(self.value(self.index(name)))
    }

    pub(in crate::rig::gige) fn float(&self, name: &str) -> f64 {
        double(self.value(self.index(name)))
    }

    pub(super) fn span(&self, index: usize) -> std::ops::Range<usize> {
        let feature = &self.features[index];
        let start = (feature.address - FEATURES_BASE) as usize;
        start..start + feature.kind.bytes() as usize
    }

    pub(in crate::rig::gige) fn value(&self, index: usize) -> &[u8] {
        &self.memory[self.span(index)]
    }

    /// The value of a selected feature for one value of its selector.
    pub(in crate::rig::gige) fn banked(&self, index: usize, selector: u32) -> &[u8] {
        self.banks.get(&(index, selector)).map_or(&self.features[index].initial, |bytes| bytes)
    }

    /// Stores a feature's value; a selected feature's also behind its selector, and a selector brings the values
    /// behind it to the front.
    pub(super) fn store(&mut self, index: usize, bytes: &[u8]) {
        let span = self.span(index);
        self.memory[span].copy_from_slice(bytes);
        if let Some(selector) = self.features[index].selector {
            let selected = self.integer(selector);
            self.banks.insert((index, selected), bytes.to_vec());
        }
        let name = self.features[index].name;
        for other in 0..self.features.len() {
            if self.features[other].selector == Some(name) {
                let front = self.banked(other, word(bytes)).to_vec();
                let span = self.span(other);
                self.memory[span].copy_from_slice(&front);
            }
        }
    }

    pub(in crate::rig::gige) fn word(&self, address: u32) -> u32 {
        word(&self.bootstrap[address as usize..])
    }

    pub(super) fn set_word(&mut self, address: u32, value: u32) {
        let start = address as usize;
        self.bootstrap[start..start + 4].copy_from_slice(&value.to_be_bytes());
    }

    pub(super) fn text(&self, address: u32, bytes: u32) -> Vec<u8> {
        let field = &self.bootstrap[address as usize..(address + bytes) as usize];
        field.iter().copied().take_while(|&byte| byte != 0).collect()
    }
}
