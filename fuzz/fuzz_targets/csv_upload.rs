#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| flankwatch_fuzz::entries::csv_upload(bytes));
