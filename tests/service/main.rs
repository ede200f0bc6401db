//! The whole program: the service over HTTP, started on a free port with a folder and a clock of its own, and the commands.
#![cfg(test)]

mod architecture;
mod assets;
mod browser;
mod command_line;
mod dashboard;
mod durability;
mod dynamics;
mod figures;
mod left_out;
mod problems;
mod real_gearbox;
mod recordings;
mod running;
mod segments;
mod trends;
