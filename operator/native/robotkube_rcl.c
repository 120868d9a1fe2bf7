/* Serialised messages, several in a call, below rclpy: rcl's take without rclpy's dictionary for each, and rcl's publish
 * at given times without a turn of the interpreter for each.
 *
 *     take(pointer, most)               [data, ...]
 *     take_timed(pointer, most)         ([(data, received), ...], number of the last one)
 *     take_sent(pointer, most)          [(data, received, sent, number), ...]
 *     publish_due(messages, late)       (published, how many of them late, refusal or None)
 *
 * `pointer`: address of an rcl_subscription_t, as rclpy's Subscription.pointer gives it; 0 is a closed one. Taking never
 * blocks; an empty answer says that no message waits. Times are ns since 1970; a number is a message's place in its
 * publisher's sequence, None when the middleware does not count. RuntimeError: what rcl says.
 *
 * `messages`: tuples (address of an rcl_publisher_t, when it is due, data) in the order of their times. Each is sent when
 * it is due, at once when that is past; the call returns after the last one, before the first that is refused, or when a
 * signal comes, and lets other threads of the interpreter run. `late`: ns from which a message counts as late.
 *
 * Why it is there, and what it saves: docs/decisions/0004-data-path.md. */
#define _GNU_SOURCE
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <stdint.h>
#include <stdio.h>
#include <time.h>

#include <rcl/error_handling.h>
#include <rcl/publisher.h>
#include <rcl/subscription.h>
#include <rcutils/allocator.h>
#include <rmw/serialized_message.h>
#include <rmw/types.h>

typedef PyObject *(*Form)(const rmw_serialized_message_t *, const rmw_message_info_t *);

static PyObject *data_of(const rmw_serialized_message_t *message) {
  return PyBytes_FromStringAndSize((const char *)message->buffer, (Py_ssize_t)message->buffer_length);
}

static PyObject *number_of(const rmw_message_info_t *info) {
  if (info->publication_sequence_number == RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED)
    Py_RETURN_NONE;
  return PyLong_FromUnsignedLongLong(info->publication_sequence_number);
}

/* A tuple of new references, which it takes over; NULL when one of them is. */
static PyObject *tuple_of(int size, PyObject *const *parts) {
  PyObject *made = PyTuple_New(size);
  for (int index = 0; index < size; index++) {
    if (made == NULL || parts[index] == NULL) {
      for (int rest = index; rest < size; rest++)
        Py_XDECREF(parts[rest]);
      Py_CLEAR(made);
      return NULL;
    }
    PyTuple_SET_ITEM(made, index, parts[index]);
  }
  return made;
}

static PyObject *alone(const rmw_serialized_message_t *message, const rmw_message_info_t *info) {
  (void)info;
  return data_of(message);
}

static PyObject *timed(const rmw_serialized_message_t *message, const rmw_message_info_t *info) {
  PyObject *parts[] = {data_of(message), PyLong_FromLongLong(info->received_timestamp)};
  return tuple_of(2, parts);
}

static PyObject *sent(const rmw_serialized_message_t *message, const rmw_message_info_t *info) {
  PyObject *parts[] = {data_of(message), PyLong_FromLongLong(info->received_timestamp),
                       PyLong_FromLongLong(info->source_timestamp), number_of(info)};
  return tuple_of(4, parts);
}

/* The messages that wait, at most `most`, as `form` writes each; `last` is about the last of them. NULL with an error. */
static PyObject *taken(PyObject *const *args, Py_ssize_t count, Form form, rmw_message_info_t *last) {
  if (count != 2)
    return PyErr_Format(PyExc_TypeError, "2 arguments are expected (pointer, most), not %zd", count);
  const rcl_subscription_t *subscription = PyLong_AsVoidPtr(args[0]);
  const Py_ssize_t most = PyLong_AsSsize_t(args[1]);
  if (PyErr_Occurred() != NULL)
    return NULL;
  if (subscription == NULL)
    return PyErr_Format(PyExc_RuntimeError, "the subscription is closed");
  PyObject *found = PyList_New(0);
  rmw_serialized_message_t message = rmw_get_zero_initialized_serialized_message();
  message.allocator = rcutils_get_default_allocator();
  rmw_message_info_t info;
  rcl_ret_t said = RCL_RET_OK;
  while (found != NULL && PyList_GET_SIZE(found) < most &&
         (said = rcl_take_serialized_message(subscription, &message, &info, NULL)) == RCL_RET_OK) {
    PyObject *one = form(&message, &info);
    *last = info;
    if (one == NULL || PyList_Append(found, one) != 0)
      Py_CLEAR(found);
    Py_XDECREF(one);
  }
  if (message.buffer != NULL)
    message.allocator.deallocate(message.buffer, message.allocator.state);
  if (said != RCL_RET_OK && said != RCL_RET_SUBSCRIPTION_TAKE_FAILED) { /* failed: none waits */
    PyErr_Format(PyExc_RuntimeError, "take: %s", rcl_get_error_string().str);
    rcl_reset_error();
    Py_CLEAR(found);
  }
  return found;
}

static PyObject *take(PyObject *self, PyObject *const *args, Py_ssize_t count) {
  (void)self;
  rmw_message_info_t last;
  return taken(args, count, alone, &last);
}

static PyObject *take_timed(PyObject *self, PyObject *const *args, Py_ssize_t count) {
  (void)self;
  rmw_message_info_t last;
  PyObject *found = taken(args, count, timed, &last);
  if (found == NULL)
    return NULL;
  PyObject *parts[] = {found, PyList_GET_SIZE(found) != 0 ? number_of(&last) : Py_NewRef(Py_None)};
  return tuple_of(2, parts);
}

static PyObject *take_sent(PyObject *self, PyObject *const *args, Py_ssize_t count) {
  (void)self;
  rmw_message_info_t last;
  return taken(args, count, sent, &last);
}

#define NANOSECONDS 1000000000LL

typedef struct {
  const rcl_publisher_t *publisher;
  long long due;
  rmw_serialized_message_t data;
} Due;

/* Reads one of `messages`; -1 with an error. The data stays in the bytes object that the caller holds. */
static int due_of(PyObject *message, Due *found) {
  PyObject *publisher, *data;
  if (!PyArg_ParseTuple(message, "OLS", &publisher, &found->due, &data))
    return -1;
  found->publisher = PyLong_AsVoidPtr(publisher);
  if (PyErr_Occurred() != NULL)
    return -1;
  found->data = rmw_get_zero_initialized_serialized_message();
  found->data.allocator = rcutils_get_default_allocator();
  found->data.buffer = (uint8_t *)PyBytes_AS_STRING(data);
  found->data.buffer_length = found->data.buffer_capacity = (size_t)PyBytes_GET_SIZE(data);
  return 0;
}

static long long wall_clock(void) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  return now.tv_sec * NANOSECONDS + now.tv_nsec;
}

/* Waits until `due`; how late it is then in ns, negative when a signal ended the wait. */
static long long waited(long long due) {
  const struct timespec end = {.tv_sec = due / NANOSECONDS, .tv_nsec = due % NANOSECONDS};
  if (due > wall_clock() && clock_nanosleep(CLOCK_REALTIME, TIMER_ABSTIME, &end, NULL) != 0)
    return -1;
  const long long late = wall_clock() - due;
  return late > 0 ? late : 0; /* a clock that was set back meanwhile */
}

static PyObject *publish_due(PyObject *self, PyObject *const *args, Py_ssize_t count) {
  (void)self;
  if (count != 2)
    return PyErr_Format(PyExc_TypeError, "2 arguments are expected (messages, late), not %zd", count);
  const long long late_from = PyLong_AsLongLong(args[1]);
  if (PyErr_Occurred() != NULL)
    return NULL;
  PyObject *messages = PySequence_Tuple(args[0]); /* holds the data */
  if (messages == NULL)
    return NULL;
  const Py_ssize_t size = PyTuple_GET_SIZE(messages);
  Due *all = PyMem_New(Due, size);
  PyObject *answer = all == NULL ? PyErr_NoMemory() : NULL;
  int read = all == NULL ? -1 : 0;
  for (Py_ssize_t index = 0; read == 0 && index < size; index++)
    read = due_of(PyTuple_GET_ITEM(messages, index), &all[index]);
  if (read == 0) {
    Py_ssize_t published = 0, late = 0;
    char refusal[RCUTILS_ERROR_MESSAGE_MAX_LENGTH] = "";
    Py_BEGIN_ALLOW_THREADS;
    for (long long past; published < size && (past = waited(all[published].due)) >= 0; published++) {
      if (all[published].publisher == NULL) {
        snprintf(refusal, sizeof refusal, "the publisher is closed");
        break;
      }
      if (rcl_publish_serialized_message(all[published].publisher, &all[published].data, NULL) != RCL_RET_OK) {
        snprintf(refusal, sizeof refusal, "%s", rcl_get_error_string().str);
        rcl_reset_error();
        break;
      }
      late += past > late_from;
    }
    Py_END_ALLOW_THREADS;
    answer = Py_BuildValue("nnz", published, late, refusal[0] == '\0' ? NULL : refusal);
  }
  PyMem_Free(all);
  Py_DECREF(messages);
  return answer;
}

#define FUNCTION(name) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, NULL}
static PyMethodDef functions[] = {FUNCTION(take), FUNCTION(take_timed), FUNCTION(take_sent), FUNCTION(publish_due), {NULL, NULL, 0, NULL}};
static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "robotkube_rcl", NULL, -1, functions, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit_robotkube_rcl(void) { return PyModule_Create(&module); }
