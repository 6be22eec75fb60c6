//! From sums of counts to emissivity and temperature. Pure: no files, no clock, no instruments.
