/* Serialised messages of a subscription, several in a call, below rclpy: rcl's take without rclpy's dictionary for each.
 *
 *     take(pointer, most)        [data, ...]
 *     take_timed(pointer, most)  ([(data, received), ...], number of the last one)
 *     take_sent(pointer, most)   [(data, received, sent, number), ...]
 *
 * `pointer`: address of an rcl_subscription_t, as rclpy's Subscription.pointer gives it; 0 is a closed one. Nothing
 * blocks; an empty answer says that no message waits. Times are ns since 1970; a number is a message's place in its
 * publisher's sequence, None when the middleware does not count. RuntimeError: what rcl says. Why it is there, and what
 * it saves: docs/decisions/0004-data-path.md. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <rcl/error_handling.h>
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

#define FUNCTION(name) {#name, (PyCFunction)(void (*)(void))name, METH_FASTCALL, NULL}
static PyMethodDef functions[] = {FUNCTION(take), FUNCTION(take_timed), FUNCTION(take_sent), {NULL, NULL, 0, NULL}};
static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "robotkube_take", NULL, -1, functions, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit_robotkube_take(void) { return PyModule_Create(&module); }
