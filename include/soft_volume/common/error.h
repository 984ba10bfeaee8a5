#pragma once

#include <stdexcept>
#include <string>

namespace soft_volume::core {

/// Base of everything that a user can cause. Every message says what is wrong and what to do about it. A developer's
/// mistake is an assert instead.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A file that is missing, damaged, of a wrong type or too large. The message starts with the file's path.
class FileError : public Error {
 public:
  using Error::Error;
};

/// A scene that cannot be used: an unknown key, a value outside its range, parts that do not fit together.
class SceneError : public Error {
 public:
  using Error::Error;
};

/// A message or call from outside that cannot be applied: not finite, of an old revision, of a wrong size. The receiver
/// reports it and keeps its state.
class InputError : public Error {
 public:
  using Error::Error;
};

}  // namespace soft_volume::core
