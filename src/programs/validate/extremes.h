#pragma once

#include "extremes_run.h"

// The numbered rows of the table of extremes, by what is extreme.

namespace soft_volume::core::validate {

void fullLimitMoves(const Options& options, Report& report);           // 1
void hugeToolForces(const Options& options, Report& report);           // 2
void neighboursAndNoise(const Options& options, Report& report);       // 3
void longSteps(const Options& options, Report& report);                // 4
void unequalMassAndStiffness(const Options& options, Report& report);  // 5
void toolSpeeds(const Options& options, Report& report);               // 6
void hugeDeformations(const Options& options, Report& report);         // 7
void conservation(const Options& options, Report& report);             // 8
void precisionAndOrigin(const Options& options, Report& report);       // 9
void freezingAndThawing(const Options& options, Report& report);       // 10
void refusedInputs(const Options& options, Report& report);            // 11

}  // namespace soft_volume::core::validate
