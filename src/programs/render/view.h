#pragma once

#include "arguments.h"
#include "soft_volume/render/camera.h"
#include "subject.h"

namespace soft_volume::core::render_program {

/// The axes of the view at azimuth and elevation 0, as Subject::view has them: patients are looked at from the front
/// with the head up.
Matrix3 patientView(const VolumeGeometry& geometry);

/// The camera that the arguments ask for, turned by `turn_deg` more. At zoom 1 the subject's box fills 95 % of the
/// picture's width or height. Throws InputError when the camera is in the grid or infinitely far.
Camera viewOf(const Arguments& arguments, const Subject& subject, double turn_deg = 0.0);

/// The depth of the cross-section in the camera's frame.
double sectionDepth(const Arguments& arguments, const Subject& subject, const Camera& camera);

}  // namespace soft_volume::core::render_program
