#pragma once

namespace scoup {

// Cycles a second of the core this runs on, over about ten milliseconds; 0 where it cannot be told.
double measure_clock_hz();

}  // namespace scoup
