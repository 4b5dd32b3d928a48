// What following features costs, against bare OpenCV (pyramid and Lucas-Kanade of 1500 points there
// and back, window 15, three levels) on the same rendered images. Detection is included in ours.
// One thread. Run both in one call and take the ratio: --benchmark_filter=960 or =3848.

#include <benchmark/benchmark.h>
#include <tbb/global_control.h>

#include <cstdio>
#include <cstdlib>
#include <map>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <vector>

#include "scenecalib/sensor/camera_factory.h"
#include "scenecalib/simulation/simulator.h"
#include "scenecalib/tracking/live_tracker.h"

namespace scenecalib {
namespace {

constexpr int kNumImages = 12;
constexpr int kNumFeatures = 1500;

struct Film {
  CameraModelPtr model;
  std::vector<GrayImage> images;
};

/// A drive of a second of the default rig's front camera; larger images are enlarged.
const Film& GetFilm(int width_px) {
  static std::map<int, Film> films;
  Film& film = films[width_px];
  if (!film.images.empty()) return film;
  SimulationOptions options;
  options.duration_s = 0.1 * (kNumImages + 1);
  options.camera.color = false;
  const Rig rig = DefaultRig().value();
  const Simulator simulator = Simulator::Create(rig, options).value();
  CameraIntrinsics intrinsics = rig.cameras[0].model->intrinsics();
  const double scale = static_cast<double>(width_px) / intrinsics.width_px;
  for (int i = 0; i < kNumImages; ++i) {
    cv::Mat pixels;
    cv::resize(simulator.RenderImage(0, i), pixels, {}, scale, scale, cv::INTER_CUBIC);
    film.images.push_back({i * 100'000'000LL, pixels});
  }
  intrinsics.width_px = film.images[0].pixels.cols;
  intrinsics.height_px = film.images[0].pixels.rows;
  intrinsics.principal_point_px *= scale;
  for (double& focal_px : intrinsics.focal_px) focal_px *= scale;
  film.model = CreateCameraModel(intrinsics).value();
  return film;
}

void Track(benchmark::State& state) {
  const Film& film = GetFilm(static_cast<int>(state.range(0)));
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  cv::setNumThreads(1);
  TrackingOptions options;
  options.detection.max_features = kNumFeatures;
  double followed = 0.0;
  for (auto _ : state) {
    state.PauseTiming();
    LiveTracker tracker(film.model, options);
    for (int i = 0; i < 3; ++i) tracker.Add(film.images[i]);
    state.ResumeTiming();
    for (int i = 3; i < kNumImages; ++i) {
      const FrameTracking frame = tracker.Add(film.images[i]);
      followed += frame.num_tracked + frame.num_rejected;
    }
  }
  const double num_images = static_cast<double>(state.iterations()) * (kNumImages - 3);
  state.counters["features"] = followed / num_images;
  state.counters["ms_an_image"] = benchmark::Counter(
      1e-3 * num_images, benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
}

void BareOpenCv(benchmark::State& state) {
  const Film& film = GetFilm(static_cast<int>(state.range(0)));
  cv::setNumThreads(1);
  const cv::Size window(15, 15);
  std::vector<std::vector<cv::Mat>> pyramids(kNumImages);
  cv::buildOpticalFlowPyramid(film.images[2].pixels, pyramids[2], window, 3);
  // Corners of every image: places that were corners an image ago cost more iterations.
  std::vector<std::vector<cv::Point2f>> points(kNumImages);
  for (int i = 2; i < kNumImages; ++i) {
    cv::goodFeaturesToTrack(film.images[i].pixels, points[i], kNumFeatures, 1e-4, 5.0);
  }
  std::vector<cv::Point2f> there, back;
  std::vector<uchar> found;
  std::vector<float> error;
  for (auto _ : state) {
    for (int i = 3; i < kNumImages; ++i) {
      cv::buildOpticalFlowPyramid(film.images[i].pixels, pyramids[i], window, 3);
      cv::calcOpticalFlowPyrLK(pyramids[i - 1], pyramids[i], points[i - 1], there, found, error,
                               window, 3);
      cv::calcOpticalFlowPyrLK(pyramids[i], pyramids[i - 1], there, back, found, error, window, 3);
    }
  }
  const double num_images = static_cast<double>(state.iterations()) * (kNumImages - 3);
  state.counters["features"] = static_cast<double>(points[2].size());
  state.counters["ms_an_image"] = benchmark::Counter(
      1e-3 * num_images, benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
}

BENCHMARK(Track)->Arg(960)->Arg(3848)->Unit(benchmark::kMillisecond);
BENCHMARK(BareOpenCv)->Arg(960)->Arg(3848)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace scenecalib
