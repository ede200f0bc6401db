//! Accept, validate, keep, process, announce: the path of a record through the service.
