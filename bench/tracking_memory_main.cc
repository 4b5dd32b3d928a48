// Memory of one live camera over minutes: the default rig's front camera at 30 images a second, its
// images shown forwards and backwards again and again, so that features come and go as on a drive.

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <string>
#include <vector>

#include "scenecalib/sensor/camera_factory.h"
#include "scenecalib/simulation/simulator.h"
#include "scenecalib/tracking/camera_tracker.h"

namespace scenecalib {
namespace {

struct Arguments {
  double minutes = 10.0;
  double rate_hz = 30.0;
  int num_rendered = 45;
  double segment_every_s = 0.0;
  int max_images = 100;
};

/// Of this process now; NaN where /proc does not say.
double ResidentMiB() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmRSS:", 0) == 0) return std::stod(line.substr(6)) / 1024.0;
  }
  return std::nan("");
}

/// The rendered images, 0 to n - 1 and back to 1, over and over.
int ShownAt(int index, int num_rendered) {
  const int period = 2 * num_rendered - 2;
  const int phase = index % period;
  return phase < num_rendered ? phase : period - phase;
}

Status Run(const Arguments& arguments) {
  const Result<Rig> rig = DefaultRig();
  if (!rig.ok()) return rig.status();
  SimulationOptions simulation;
  simulation.camera.color = false;
  simulation.camera.rate_hz = arguments.rate_hz;
  simulation.duration_s = (arguments.num_rendered + 2) / arguments.rate_hz;
  const Result<Simulator> simulator = Simulator::Create(*rig, simulation);
  if (!simulator.ok()) return simulator.status();
  std::vector<cv::Mat> film;
  for (int i = 0; i < arguments.num_rendered; ++i) film.push_back(simulator->RenderImage(0, i));

  TrackingOptions options;
  options.buffer.max_images = arguments.max_images;
  const CameraConfig& camera = rig->cameras.front();
  CameraTracker tracker(camera.name, camera.model, options);
  const auto num_images = static_cast<int>(60.0 * arguments.minutes * arguments.rate_hz);
  const auto row = static_cast<int>(20.0 * arguments.rate_hz);
  const auto between_segments = static_cast<int>(arguments.segment_every_s * arguments.rate_hz);
  std::printf("   s  resident MiB  tracked  CPU ms an image\n");
  double since_ms = 1e3 * static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
  for (int i = 0; i < num_images; ++i) {
    const auto stamp_ns = static_cast<Timestamp>(1e9 * (1.0 + i / arguments.rate_hz));
    const Result<FrameTracking> frame = tracker.AddImage(
        {stamp_ns, film[static_cast<std::size_t>(ShownAt(i, arguments.num_rendered))]});
    if (!frame.ok()) return frame.status();
    if (between_segments > 0 && (i + 1) % between_segments == 0) {
      const CameraSegment segment = tracker.Segment();
      std::printf("%4.0f  segment of %zu images and %zu tracks\n", (i + 1) / arguments.rate_hz,
                  segment.images.size(), segment.tracks.size());
    }
    if ((i + 1) % row != 0) continue;
    const double now_ms = 1e3 * static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
    std::printf("%4.0f  %12.1f  %7d  %15.1f\n", (i + 1) / arguments.rate_hz, ResidentMiB(),
                frame->num_tracked, (now_ms - since_ms) / row);
    std::fflush(stdout);
    since_ms = now_ms;
  }
  return Status::Ok();
}

}  // namespace
}  // namespace scenecalib

int main(int argc, char** argv) {
  CLI::App app("Memory of one live camera over minutes.");
  scenecalib::Arguments arguments;
  app.add_option("--minutes", arguments.minutes, "that the camera runs");
  app.add_option("--rate", arguments.rate_hz, "images per second");
  app.add_option("--rendered", arguments.num_rendered, "different images")
      ->check(CLI::Range(3, 10000));
  app.add_option("--segment-every", arguments.segment_every_s,
                 "seconds between recalibrations' requests for all tracks, 0 for none");
  app.add_option("--max-images", arguments.max_images, "kept (tracking.buffer.max_images)");
  CLI11_PARSE(app, argc, argv);
  const scenecalib::Status status = scenecalib::Run(arguments);
  if (!status.ok()) {
    std::fprintf(stderr, "%s\n", status.message().c_str());
    return 1;
  }
  return 0;
}
