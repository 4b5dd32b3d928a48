#pragma once

#include <string>

#include "scenecalib/base/status.h"
#include "scenecalib/pipeline/calibration_pipeline.h"

namespace scenecalib {

/// What a person wants to know of a run: cost and evidence of every stage, warnings.
std::string FormatReport(const PipelineResult& result);

/// Writes a run's files into `directory` (made when missing): calibration.yaml, trajectory.tum,
/// ground.ply, surfels.ply, overlays/<camera>_{before,after}.png, report.txt with `report`,
/// report/index.html (evaluation/report_page.h).
/// Everything is written beside first and moved into place at the end, calibration.yaml last: an
/// earlier result is never lost to a failed run. Unavailable when the disk refuses.
Status WriteArtifacts(const std::string& directory, const PipelineResult& result,
                      const std::string& report);

}  // namespace scenecalib
